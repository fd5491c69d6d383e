"""The windows that an online process is fitted to, recorded in flight; and harder ones at random.

    python -m benchmarks.online_gp_windows --robot quadrotor --out windows.npz

flies the drawings and stores the windows. `benchmarks.online_gp` calls it in a process of its own,
so that no simulator's threads run beside what is timed.
"""

from __future__ import annotations

import argparse
import math
import os
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.planar_robot import planar_double_integrator, tracking_limits
from nufleet import sims
from nufleet.robot_agent.flight.online_gp import WINDOW_POINTS, Correction, OnlineGp
from nufleet.robot_agent.flight.tracking import PAIR_SPACING_S, Learner, track
from nufleet.robot_agent.flight.tracking_record import TrackingRecord
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.problem import Hyperparameters
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.fleet_file import read_fleet_file, validated_settings
from nufleet.sims import drawings

ROBOTS = ("quadrotor", "double-integrator")
HORIZON_S = {"quadrotor": 0.4, "double-integrator": 0.2}
SPEED_M_S = 0.7
ACCELERATION_M_S2 = 1.6
DIMENSION = 5


@dataclass(frozen=True, eq=False)
class Windows:
    """Full windows, one step after another.

    inputs (steps, axes, points, d), targets (steps, axes, points), queries (steps, axes, d); `new`
    (steps,) is how many of a window's last rows the step before did not have.
    """

    inputs: FloatArray
    targets: FloatArray
    queries: FloatArray
    new: np.ndarray

    def __len__(self) -> int:
        return len(self.inputs)

    def part(self, steps: np.ndarray) -> Windows:
        """Return some steps; one that does not follow its predecessor has a whole new window."""
        follows = np.diff(steps, prepend=steps[:1] - 2) == 1
        points = self.inputs.shape[2]
        return Windows(
            self.inputs[steps],
            self.targets[steps],
            self.queries[steps],
            np.where(follows, self.new[steps], points),
        )


def joined(parts: list[Windows]) -> Windows:
    """Return the steps of several windows, one after another."""
    return Windows(
        np.concatenate([part.inputs for part in parts]),
        np.concatenate([part.targets for part in parts]),
        np.concatenate([part.queries for part in parts]),
        np.concatenate([part.new for part in parts]),
    )


class RecordingGp(OnlineGp):
    """An online process with a zero prior that keeps all it is given."""

    def __init__(self, layout: InverseLayout, axes: int) -> None:
        super().__init__(layout, (None,) * axes)
        self._gp_inputs = layout.gp_inputs
        self._pairs: list[list[tuple[FloatArray, float]]] = [[] for _ in range(axes)]
        self._asked: list[FloatArray] = []

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        """Take a pair; with a zero prior γ is the residual."""
        self._pairs[axis].append((self._gp_inputs(inputs[np.newaxis])[0], gamma))
        super().learn(axis, inputs, gamma)

    def correct(self, inputs: FloatArray) -> Correction:
        """Answer as ever; what counts is the first query of each window."""
        if len(self._pairs[0]) == len(self._asked):
            self._asked.append(self._gp_inputs(inputs))
        return super().correct(inputs)

    def windows(self) -> Windows:
        """Return every full window. The first query has no pair before it, every other one more."""
        inputs = np.stack([[x for x, _ in pairs] for pairs in self._pairs], axis=1)
        targets = np.stack([[y for _, y in pairs] for pairs in self._pairs], axis=1)
        if len(self._asked) != len(inputs) + 1:
            raise ValueError(f"{len(self._asked)} queries do not fit {len(inputs)} pairs per axis")
        sliding = np.lib.stride_tricks.sliding_window_view
        steps = len(inputs) - WINDOW_POINTS + 1
        return Windows(
            sliding(inputs, WINDOW_POINTS, axis=0).transpose(0, 1, 3, 2).copy(),
            sliding(targets, WINDOW_POINTS, axis=0).copy(),
            np.array(self._asked[WINDOW_POINTS:]),
            np.where(np.arange(steps) == 0, WINDOW_POINTS, 1),
        )


def quadrotor() -> Robot:
    """Return the target of the paper's quadrotors, ready to fly."""
    from nufleet.sims.quadrotors.driver import DRIVER

    path = Path(sims.__file__).with_name("fleets") / "paper_quadrotors.toml"
    entry = read_fleet_file(path).robots["target"]
    settings = {"target": validated_settings(DRIVER.settings, path, "target", entry.settings)}
    robot = DRIVER.build(settings, np.random.default_rng(0))["target"]  # type: ignore[arg-type]
    robot.connect()
    return robot


def fly(
    kind: str, drawing: Path, pair_spacing_s: float = PAIR_SPACING_S
) -> tuple[Windows, TrackingRecord]:
    """Track one drawing with the paper's architecture and a zero prior.

    There is one window for each pair that the process learned, from number `WINDOW_POINTS` on.

    Raises:
        RuntimeError: the flight failed.
    """
    robot = quadrotor() if kind == "quadrotor" else planar_double_integrator(0.002)
    sample_time_s = robot.spec.sample_time_s
    layout = InverseLayout(
        architecture="state",
        states=robot.state_names,
        sample_time_s=sample_time_s,
        horizon_samples=round(HORIZON_S[kind] / sample_time_s),
    )
    path = travel(read_drawing(drawing), SPEED_M_S, ACCELERATION_M_S2, sample_time_s)
    process = RecordingGp(layout, path.shape[1])
    learner = Learner(layout, process, pair_spacing_s)
    flight = track(robot, path, tracking_limits(robot), learner)
    if flight.failure is not None:
        raise RuntimeError(f"the flight along {drawing.stem} failed: {flight.failure}")
    return process.windows(), flight


def recorded(kind: str, file: Path) -> Windows:
    """Fly the drawings in another process, store the windows in a file and read them."""
    extra = {}
    if kind == "quadrotor":
        from nufleet.sims.quadrotors.environment import environment

        extra = environment()
    command = [sys.executable, "-m", __spec__.name, "--robot", kind, "--out", str(file)]
    subprocess.run(command, check=True, env={**os.environ, **extra})
    return read(file)


def read(file: Path) -> Windows:
    """Read stored windows."""
    with np.load(file, allow_pickle=False) as stored:
        return Windows(**{name: stored[name] for name in ("inputs", "targets", "queries", "new")})


def random_windows(steps: int, axes: int, rng: np.random.Generator) -> Windows:
    """Measure functions drawn from priors whose hyperparameters spread over most of the bounds.

    Inputs are normal, each of an extent of its own; a window has nothing to do with the one before.
    """
    n = WINDOW_POINTS
    inputs, targets = np.empty((steps, axes, n, DIMENSION)), np.empty((steps, axes, n))
    queries = np.empty((steps, axes, DIMENSION))
    for step in range(steps):
        for axis in range(axes):
            extents = np.exp(rng.uniform(math.log(0.1), math.log(2.0), DIMENSION))
            points = extents * rng.standard_normal((n + 1, DIMENSION))
            logs = [(1e-3, 1.0), (0.5, 20.0), (2e-3, 0.2)]
            drawn = np.exp([rng.uniform(math.log(low), math.log(high)) for low, high in logs])
            covariance = matern(points[:n], Hyperparameters(*drawn)) + drawn[2] * np.eye(n)
            inputs[step, axis], queries[step, axis] = points[:n], points[n]
            targets[step, axis] = np.linalg.cholesky(covariance) @ rng.standard_normal(n)
    return Windows(inputs, targets, queries, np.full(steps, n))


def matern(points: FloatArray, of: Hyperparameters) -> FloatArray:
    """Return the covariance of the function, Matérn 3/2, without noise, shape (points, points)."""
    distance = np.linalg.norm(points[:, np.newaxis] - points[np.newaxis], axis=2)
    scaled = math.sqrt(3.0) * distance / of.lengthscale
    return np.asarray(of.signal_variance * (1.0 + scaled) * np.exp(-scaled))


def main() -> None:
    """Fly the drawings and store their windows."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--robot", choices=ROBOTS, default=ROBOTS[0])
    parser.add_argument("--out", type=Path, required=True)
    arguments = parser.parse_args()
    parts = []
    for drawing in drawings.ALL:
        windows, flight = fly(arguments.robot, drawing)
        error_mm = 1e3 * flight.rms_error
        print(f"{drawing.stem}: {len(flight.actual)} samples, RMS error {error_mm:.1f} mm")
        parts.append(windows)
    windows = joined(parts)
    np.savez(arguments.out, **asdict(windows))


if __name__ == "__main__":
    main()
