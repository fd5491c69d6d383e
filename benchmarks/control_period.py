"""Does the control period hold? A robot tracks drawings for minutes by a real clock.

Two of Section V's double integrators, samples of 15 ms, follow the drawings with all that a
transfer brings: a network of four layers of 128 units, trained on a flight before, as prior; online
processes for x and y; and the guard. A miss is a reference that reaches the robot later than its
sample lasts, the wait for the processor included. Needs torch, for the training.

    python -m benchmarks.control_period --minutes 10
"""

from __future__ import annotations

import argparse
import json
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.planar_robot import (
    ClockedRobot,
    PlanarRobot,
    planar_double_integrator,
    tracking_limits,
)
from nufleet.orchestrator.experience.lesson_record import LearningRecord, pooled_pairs
from nufleet.orchestrator.experience.training import STEPS_MAX, Origin, TrainingData, train
from nufleet.robot_agent.flight.equipment import guard_for
from nufleet.robot_agent.flight.forecast import forecast_of
from nufleet.robot_agent.flight.guard import Guard
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.online_gp import OnlineGp
from nufleet.robot_agent.flight.own_model import evidence_in
from nufleet.robot_agent.flight.rich_flight import fly_record
from nufleet.robot_agent.flight.tracking import Learner, track
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.exact import warm_up
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.references import rich_references
from nufleet.shared.paths.trajectories import travel
from nufleet.sims import drawings

HORIZON_SAMPLES = 13
SPEED_M_S, ACCELERATION_M_S2 = 0.7, 1.6
NOISE_STD_M = 0.001
BRAKING_S = 2.0


@dataclass(frozen=True)
class ClockedFlight:
    """A flight by the clock.

    `choosing_…` is what choosing a reference took, of both; `arrival_…` is how long after the
    sample's beginning the reference arrived, late wake-ups included. `misses` counts arrivals after
    the sample's end, `choices_too_long` what `TrackingRecord.deadline_misses` counts.
    """

    minutes: float
    samples: int
    sample_time_ms: float
    misses: int
    choices_too_long: int
    choosing_median_ms: float
    choosing_p99_ms: float
    choosing_worst_ms: float
    arrival_median_ms: float
    arrival_p99_ms: float
    arrival_worst_ms: float
    worst_at_s: float
    rms_error_mm: float
    baseline_rms_error_mm: float
    taken_back: str | None
    processes_running: float


def laps(duration_s: float, sample_time_s: float) -> FloatArray:
    """Return the drawings one after another, from rest to rest, again and again, (samples, 2).

    Where the time is over in the middle of one, the path comes to rest there within two seconds.
    """
    paths = [read_drawing(drawing) for drawing in drawings.ALL]
    lines = [
        np.stack([path[-1], following[0]])
        for path, following in zip(paths, paths[1:] + paths[:1], strict=True)
    ]
    legs = [leg for pair in zip(paths, lines, strict=True) for leg in pair]
    lap = np.concatenate([travel(leg, SPEED_M_S, ACCELERATION_M_S2, sample_time_s) for leg in legs])
    samples = round(duration_s / sample_time_s)
    braking = min(samples, round(BRAKING_S / sample_time_s))
    rate = np.concatenate([np.ones(samples - braking), np.linspace(1.0, 0.0, braking)])
    along = np.concatenate([[0.0], np.cumsum(rate)[:-1]]) % (len(lap) - 1)
    return np.stack([np.interp(along, np.arange(len(lap)), column) for column in lap.T], axis=1)


def prepared(
    robot: PlanarRobot, desired: FloatArray, training_steps_max: int
) -> tuple[Learner, Guard]:
    """Fly a record, fit the prior and the baseline's model to it, return learner and guard."""
    spec = robot.spec
    record = fly_record(robot, rich_references(spec, 60.0, np.random.default_rng(0)))
    layout = InverseLayout(
        architecture="state",
        states=robot.state_names,
        sample_time_s=spec.sample_time_s,
        horizon_samples=HORIZON_SAMPLES,
    )
    experience = train(
        TrainingData(
            *pooled_pairs(
                layout,
                LearningRecord(record.references, record.states, robot.state_names),
                (0, 1),
            )
        ),
        layout,
        Origin("target", spec.kind, ("x", "y"), "m", relative_degree=1),
        seed=0,
        steps_max=training_steps_max,
    )
    prior = NetworkInverse(experience)
    memory = Memory(None)
    memory.learn(evidence_in(spec, record.references, record.states[:, :, 0]))
    forecast = forecast_of(memory.own_model(spec).model, desired)
    if forecast is None:
        raise RobotError("nothing was learned of the baseline")
    guard = guard_for(forecast, robot, fallback=False)
    return Learner(layout, OnlineGp(layout, (prior, prior))), guard


def fly_by_the_clock(minutes: float, training_steps_max: int = STEPS_MAX) -> ClockedFlight:
    """Fly laps in real time.

    Args:
        minutes: Duration of the flight; the training before it is not paced.
        training_steps_max: Largest number of steps in the training of the prior.

    Raises:
        RuntimeError: The flight failed.
    """
    warm_up()
    robot = planar_double_integrator(NOISE_STD_M)
    sample_time_s = robot.spec.sample_time_s
    desired = laps(60.0 * minutes, sample_time_s)
    limits = tracking_limits(robot)
    baseline = track(planar_double_integrator(NOISE_STD_M), desired, limits)
    learner, guard = prepared(robot, desired, training_steps_max)
    clocked = ClockedRobot(robot)
    flight = track(clocked, desired, limits, learner, guard)
    if flight.failure is not None:
        raise RuntimeError(f"the flight failed: {flight.failure}")
    choosing_ms, arrival_ms = 1e3 * flight.step_time_s, 1e3 * np.array(clocked.reference_s)
    return ClockedFlight(
        minutes=len(desired) * sample_time_s / 60,
        samples=len(desired),
        sample_time_ms=1e3 * sample_time_s,
        misses=int((arrival_ms > 1e3 * sample_time_s).sum()),
        choices_too_long=flight.deadline_misses,
        choosing_median_ms=float(np.median(choosing_ms)),
        choosing_p99_ms=float(np.quantile(choosing_ms, 0.99)),
        choosing_worst_ms=float(choosing_ms.max()),
        arrival_median_ms=float(np.median(arrival_ms)),
        arrival_p99_ms=float(np.quantile(arrival_ms, 0.99)),
        arrival_worst_ms=float(arrival_ms.max()),
        worst_at_s=float(np.argmax(arrival_ms) * sample_time_s),
        rms_error_mm=1e3 * flight.rms_error,
        baseline_rms_error_mm=1e3 * baseline.rms_error,
        taken_back=flight.taken_back.reason if flight.taken_back is not None else None,
        processes_running=os.getloadavg()[0],
    )


def print_flight(flight: ClockedFlight) -> None:
    """Print the flight's figures."""
    print(
        f"\n{flight.minutes:.2f} minutes by the clock, {flight.samples} samples of "
        f"{flight.sample_time_ms:g} ms, {flight.processes_running:.1f} processes running at the end"
    )
    print(
        f"  deadlines missed: {flight.misses}; of the choices alone: {flight.choices_too_long}\n"
        f"  choosing a reference: median {flight.choosing_median_ms:.3f} ms, 99 % "
        f"{flight.choosing_p99_ms:.3f} ms, worst {flight.choosing_worst_ms:.3f} ms\n"
        f"  its arrival after the sample's beginning: median {flight.arrival_median_ms:.3f} ms, "
        f"99 % {flight.arrival_p99_ms:.3f} ms, worst {flight.arrival_worst_ms:.3f} ms at "
        f"{flight.worst_at_s:.2f} s\n"
        f"  RMS error {flight.rms_error_mm:.1f} mm, of the baseline alone "
        f"{flight.baseline_rms_error_mm:.1f} mm; "
        + (f"withdrawn: {flight.taken_back}" if flight.taken_back else "prior never withdrawn")
    )


def main() -> None:
    """Parse the command line, fly, print."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    with threadpool_limits(1):
        flight = fly_by_the_clock(arguments.minutes)
    print_flight(flight)
    if arguments.json:
        arguments.json.write_text(json.dumps(asdict(flight), indent=2))


if __name__ == "__main__":
    main()
