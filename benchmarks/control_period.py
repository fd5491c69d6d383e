"""Does the control period hold? A robot tracks drawings for minutes by a real clock.

Two of Section V's double integrators, samples of 15 ms, follow the drawings with all that a
transfer brings: a prior network of four layers of 128 units, online processes for x and y, and the
guard. The network's weights hold a linear inverse that was fitted to a flight before. A miss is a
reference that reaches the robot later than its sample lasts, the wait for the processor included.

    python -m benchmarks.control_period --minutes 10
"""

from __future__ import annotations

import argparse
import json
import math
import os
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from threadpoolctl import threadpool_limits

from benchmarks.planar_robot import LIMITS, PacedRobot, PlanarRobot, planar_double_integrator
from robot_agent.baseline_model import identify_baseline
from robot_agent.guard import Guard
from robot_agent.horizon import pooled_pairs
from robot_agent.inverse_model import LinearInverse, NetworkInverse
from robot_agent.online_gp import OnlineGp
from robot_agent.rich_flight import FlightRecord, fly_record, rich_references
from robot_agent.tracking import Learner, track
from shared.arrays import FloatArray
from shared.drawing_files import read_drawing
from shared.experience import Experience, ExperienceManifest
from shared.gaussian_process import warm_up
from shared.inverse_layout import InverseLayout
from shared.trajectories import travel
from sims import drawings

HORIZON_SAMPLES = 13
SPEED_M_S, ACCELERATION_M_S2 = 0.7, 1.6
NOISE_STD_M = 0.001
WIDTH, LAYERS = 128, 4


@dataclass(frozen=True)
class PacedFlight:
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
    """Return the drawings one after another, from rest to rest, again and again, (samples, 2)."""
    paths = [read_drawing(drawing) for drawing in drawings.ALL]
    lines = [
        np.stack([path[-1], following[0]])
        for path, following in zip(paths, paths[1:] + paths[:1], strict=True)
    ]
    legs = [leg for pair in zip(paths, lines, strict=True) for leg in pair]
    lap = np.concatenate([travel(leg, SPEED_M_S, ACCELERATION_M_S2, sample_time_s) for leg in legs])
    samples = round(duration_s / sample_time_s)
    return np.tile(lap, (math.ceil(samples / len(lap)), 1))[:samples]


def network_of(inverse: LinearInverse, layout: InverseLayout) -> NetworkInverse:
    """Return a network of the paper's size that computes a linear inverse exactly.

    The first layer holds every input and its negative, the others pass on what is not negative, and
    the last adds them up. All other units compute as much, of small random weights, for nothing.
    """
    rng = np.random.default_rng(0)
    inputs = len(inverse.weights)
    used = 2 * inputs
    manifest = ExperienceManifest(
        robot="target",
        robot_kind="planar-double-integrator",
        axes=("x", "y"),
        unit="m",
        layout=layout,
        inputs=layout.input_names,
        relative_degree=1,
        hidden=(WIDTH,) * LAYERS,
        input_mean=(0.0,) * inputs,
        input_scale=(1.0,) * inputs,
        output_mean=0.0,
        output_scale=1.0,
        points=1,
        validation_rms=0.0,
        data_sha256="0" * 64,
        seed=0,
        training_version="a linear inverse",
    )
    arrays = {
        name: (0.1 * rng.standard_normal(shape)).astype(np.float32)
        for name, shape in manifest.shapes.items()
    }
    signs = np.concatenate([np.eye(inputs), -np.eye(inputs)], axis=1)
    arrays["weight_0"][:, :used] = signs
    arrays["bias_0"][:used] = 0.0
    for layer in range(1, LAYERS):
        arrays[f"weight_{layer}"][:, :used] = np.eye(WIDTH, used)
        arrays[f"bias_{layer}"][:used] = 0.0
    arrays[f"weight_{LAYERS}"][:] = 0.0
    arrays[f"weight_{LAYERS}"][:used, 0] = inverse.weights @ signs
    arrays[f"bias_{LAYERS}"][:] = 0.0
    return NetworkInverse(Experience(manifest, arrays))


def prepared(robot: PlanarRobot, desired: FloatArray) -> tuple[Learner, Guard]:
    """Fly a record, fit the prior and the baseline's model to it, return learner and guard."""
    spec = robot.spec
    references = rich_references(spec, spec.axes, 60.0, np.random.default_rng(0))
    record: FlightRecord = fly_record(robot, references)
    layout = InverseLayout(
        architecture="state",
        states=robot.state_names,
        sample_time_s=spec.sample_time_s,
        horizon_samples=HORIZON_SAMPLES,
    )
    prior = network_of(LinearInverse(*pooled_pairs(layout, record, (0, 1))), layout)
    models = [
        identify_baseline(
            [(record.references[:, axis], record.states[:, axis, 0])],
            spec.sample_time_s,
            spec.settling_time_s,
        )
        for axis in (0, 1)
    ]
    errors = np.stack([model.error(desired[:, i]) for i, model in enumerate(models)], axis=1)
    noise_variance = sum(model.residual_std**2 for model in models)
    guard = Guard(errors, noise_variance, spec.sample_time_s)
    return Learner(layout, OnlineGp(layout, (prior, prior))), guard


def fly_by_the_clock(minutes: float) -> PacedFlight:
    """Fly so many minutes of laps in real time.

    Raises:
        RuntimeError: the flight failed.
    """
    warm_up()
    robot = planar_double_integrator(NOISE_STD_M)
    sample_time_s = robot.spec.sample_time_s
    desired = laps(60.0 * minutes, sample_time_s)
    baseline = track(planar_double_integrator(NOISE_STD_M), desired, LIMITS)
    learner, guard = prepared(robot, desired)
    paced = PacedRobot(robot)
    flight = track(paced, desired, LIMITS, learner, guard)
    if flight.failure is not None:
        raise RuntimeError(f"the flight failed: {flight.failure}")
    choosing_ms, arrival_ms = 1e3 * flight.step_time_s, 1e3 * np.array(paced.reference_s)
    return PacedFlight(
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


def print_flight(flight: PacedFlight) -> None:
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
        + (f"taken back: {flight.taken_back}" if flight.taken_back else "prior never taken back")
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
