"""What one step of a mixture of experiences costs, beside one step of a single prior.

A step is what a robot does in every sample, for x and y: at every eighth sample one more pair for
each axis, which a mixture also weighs its experts by; the windows of 50 points fitted to
convergence, and one prediction each. Experts are networks of the paper's size, 4 × 128. Both fly
the same paths of Section V's target, one after the other and by turns, in this process; what counts
against the figures is the processor's time of the step, since another process may hold the
processor in between. The ratio of the two says the same on any machine.

    python -m benchmarks.mixture_step --rounds 5 --json mixture_step.json
"""

from __future__ import annotations

import argparse
import json
import os
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table
from threadpoolctl import threadpool_limits

from benchmarks.planar_robot import planar_double_integrator, tracking_limits
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.mixture_process import Expert, MixtureProcess
from nufleet.robot_agent.flight.online_gp import Correction, OnlineGp
from nufleet.robot_agent.flight.tracking import Learner, track
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.file import Experience
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.gaussian_process.exact import warm_up
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.trajectories import travel
from nufleet.sims import drawings

MEDIAN_MAX_MS, P99_MAX_MS = 1.0, 3.0
SOURCES = 5
HORIZON_SAMPLES = 13
SPEED_M_S, ACCELERATION_M_S2 = 0.7, 1.6
PATHS = ("clover", "shell")


@dataclass(frozen=True)
class Row:
    """The time of one step in ms, of the processor and by the clock."""

    name: str
    steps: int
    processor_median_ms: float
    processor_p99_ms: float
    wall_median_ms: float
    wall_p99_ms: float


class _Timed:
    """Adds up the time between two answers of a process that is spent in it."""

    def __init__(self) -> None:
        self.processor_s: list[float] = []
        self.wall_s: list[float] = []
        self._begin = self._spent = np.zeros(2)

    def begin(self) -> None:
        self._begin = _now()

    def end(self, *, answered: bool) -> None:
        self._spent = self._spent + _now() - self._begin
        if answered:
            self.processor_s.append(float(self._spent[0]))
            self.wall_s.append(float(self._spent[1]))
            self._spent = np.zeros(2)

    def row(self, name: str) -> Row:
        processor, wall = 1e3 * np.array(self.processor_s), 1e3 * np.array(self.wall_s)
        return Row(
            name,
            len(processor),
            float(np.median(processor)),
            float(np.quantile(processor, 0.99)),
            float(np.median(wall)),
            float(np.quantile(wall, 0.99)),
        )


def _now() -> FloatArray:
    return np.array([time.thread_time(), time.perf_counter()])


class _TimedGp(OnlineGp):
    """A single prior whose steps are timed."""

    def __init__(self, layout: InverseLayout, inverse: NetworkInverse, timed: _Timed) -> None:
        super().__init__(layout, (inverse, inverse))
        self._timed = timed

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        self._timed.begin()
        super().learn(axis, inputs, gamma)
        self._timed.end(answered=False)

    def correct(self, inputs: FloatArray) -> Correction:
        self._timed.begin()
        answer = super().correct(inputs)
        self._timed.end(answered=True)
        return answer


class _TimedMixture(MixtureProcess):
    """A mixture whose steps are timed."""

    def __init__(self, layout: CombinedLayout, experts: list[Expert], timed: _Timed) -> None:
        super().__init__(layout, experts)
        self._timed = timed

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        self._timed.begin()
        super().learn(axis, inputs, gamma)
        self._timed.end(answered=False)

    def correct(self, inputs: FloatArray) -> Correction:
        self._timed.begin()
        answer = super().correct(inputs)
        self._timed.end(answered=True)
        return answer


def layout_of(states: tuple[str, ...], sample_time_s: float, horizon: int) -> InverseLayout:
    """Return the paper's layout with a horizon in samples."""
    return InverseLayout(
        architecture="state",
        states=states,
        sample_time_s=sample_time_s,
        horizon_samples=horizon,
    )


def network(layout: InverseLayout, seed: int) -> NetworkInverse:
    """Return a network of the paper's size and random weights, whose answers are small."""
    rng = np.random.default_rng(seed)
    names = layout.input_names
    manifest = ExperienceManifest(
        robot=f"source-{seed}",
        robot_kind="planar-double-integrator",
        axes=("x", "y"),
        unit="m",
        layout=layout,
        inputs=names,
        relative_degree=1,
        input_mean=(0.0,) * len(names),
        input_scale=(0.3,) * len(names),
        output_mean=0.0,
        output_scale=0.02,
        points=2100,
        validation_rms=0.01,
        data_sha256="0" * 64,
        seed=seed,
        training_version="random",
    )
    arrays = {
        name: (rng.standard_normal(shape) / np.sqrt(shape[0])).astype(np.float32)
        for name, shape in manifest.shapes.items()
    }
    return NetworkInverse(Experience(manifest, arrays))


def measure(rounds: int) -> list[Row]:
    """Fly by turns with a single prior, with a mixture, and with one of five horizons."""
    robot = planar_double_integrator(0.002)
    sample_time_s, states = robot.spec.sample_time_s, robot.state_names
    horizons = [HORIZON_SAMPLES + place for place in range(SOURCES)]
    layouts = [layout_of(states, sample_time_s, horizon) for horizon in horizons]
    alike = [network(layouts[0], seed) for seed in range(SOURCES)]
    apart = [network(layout, seed) for seed, layout in enumerate(layouts)]
    weight = 1 / (SOURCES + 1)
    both = (True, True)
    mixtures = {
        "mixture of 5": [Expert(f"{i}", layouts[0], m, weight, both) for i, m in enumerate(alike)],
        "mixture of 5, five horizons": [
            Expert(f"{i}", layout, model, weight, both)
            for i, (layout, model) in enumerate(zip(layouts, apart, strict=True))
        ],
    }
    times = {name: _Timed() for name in ("single prior", *mixtures)}
    folder = Path(drawings.__file__).parent
    for _ in range(rounds):
        for drawing in PATHS:
            (file,) = folder.glob(f"{drawing}.*")
            path = travel(read_drawing(file), SPEED_M_S, ACCELERATION_M_S2, sample_time_s)
            single = _TimedGp(layouts[0], alike[0], times["single prior"])
            learners = [Learner(layouts[0], single)]
            for name, experts in mixtures.items():
                combined = CombinedLayout([expert.layout for expert in experts])
                process = _TimedMixture(combined, experts, times[name])
                learners.append(Learner(combined, process))
            for learner in learners:
                flight = track(robot, path, tracking_limits(robot), learner)
                if flight.failure is not None:
                    raise RuntimeError(f"the flight along {drawing} failed: {flight.failure}")
    return [timed.row(name) for name, timed in times.items()]


def print_rows(console: Console, rows: list[Row]) -> None:
    """Print the times, their ratio to a single prior's, and whether the figures hold."""
    table = Table(title="one step of x and y, ms", title_justify="left")
    for heading in ("", "steps", "median, processor", "99 %, processor", "median", "99 %",
                    "× single"):  # fmt: skip
        table.add_column(heading, justify="right" if heading else "left")
    for row in rows:
        times = (
            row.processor_median_ms,
            row.processor_p99_ms,
            row.wall_median_ms,
            row.wall_p99_ms,
        )
        ratio = row.processor_median_ms / rows[0].processor_median_ms
        table.add_row(row.name, str(row.steps), *(f"{t:.3f}" for t in times), f"{ratio:.2f}")
    console.print(table)
    for row in rows[1:]:
        holds = row.processor_median_ms < MEDIAN_MAX_MS and row.processor_p99_ms < P99_MAX_MS
        console.print(
            f"  {row.name}: median below {MEDIAN_MAX_MS:g} ms and 99 % below {P99_MAX_MS:g} ms of "
            f"the processor's time: {'holds' if holds else 'DOES NOT HOLD'}",
            highlight=False,
        )


def main() -> None:
    """Parse the command line, measure, print and store."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=5, help="of all flights")
    parser.add_argument("--json", type=Path, help="also write the numbers to this file")
    arguments = parser.parse_args()
    warm_up()
    console = Console(width=120)
    console.print(
        f"{os.cpu_count()} processors, on which {os.getloadavg()[0]:.1f} processes run; one thread"
    )
    with threadpool_limits(1):
        measure(1)
        rows = measure(arguments.rounds)
    print_rows(console, rows)
    if arguments.json:
        arguments.json.write_text(json.dumps([asdict(row) for row in rows], indent=2))


if __name__ == "__main__":
    main()
