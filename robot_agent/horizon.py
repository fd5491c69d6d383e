"""The horizon of an inverse model, chosen by flying candidates on the robot they are for."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from robot_agent.inverse_model import InverseModel, LinearInverse
from robot_agent.online_gp import OnlineGp
from robot_agent.rich_flight import FlightRecord
from robot_agent.robot import Robot
from robot_agent.tracking import Learner, track
from shared.arrays import FloatArray
from shared.errors import RobotError
from shared.inverse_layout import InverseLayout
from shared.trajectories import TrackingLimits

CANDIDATES_S = (0.1, 0.15, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7)
"""From the delay of a fast robot to the rise time of a slow one."""

_CLOSE = 1.05  # errors that differ by less are alike
_GAIN_ERROR = 1.25  # a horizon has to survive an inverse this much too eager


@dataclass(frozen=True)
class Trial:
    """How a candidate tracked its own robot; infinite where the robot failed."""

    horizon_samples: int
    rms_error: float


@dataclass(frozen=True)
class HorizonChoice:
    """The layout that was chosen, and what every candidate did, shortest horizon first."""

    layout: InverseLayout
    trials: tuple[Trial, ...]


class _Eager:
    """An inverse whose γ is too large: a target is never quite the source."""

    def __init__(self, inverse: InverseModel) -> None:
        self._inverse = inverse

    def __call__(self, inputs: FloatArray) -> FloatArray:
        return np.asarray(_GAIN_ERROR * self._inverse(inputs))


def choose_horizon(
    robot: Robot,
    record: FlightRecord,
    path: FloatArray,
    limits: TrackingLimits,
    *,
    architecture: Literal["state", "preview"],
    axes: tuple[int, ...],
    relative_degree: int,
    candidates_s: tuple[float, ...] = CANDIDATES_S,
) -> HorizonChoice:
    """Fly a linear inverse with every horizon, longest first, and keep the one that tracks best.

    A feedback (`state`) is judged by the worse of two flights, one with γ as learned and one with γ
    a quarter too large, so that a horizon on the verge of instability does not win; of horizons
    that track alike the longest is the gentlest. A preview cannot become unstable; of those the
    shortest is taken, whose training pairs are the freshest in flight.

    Args:
        robot: the one that the inverse is learned on, connected and at rest.
        record: what the linear inverses are fitted to.
        path: what is flown, shape (samples, axes).
        limits: of the flights.
        architecture: of the layout.
        axes: the columns whose pairs are pooled.
        relative_degree: in samples; no horizon is shorter.
        candidates_s: the horizons to try.

    Raises:
        RobotError: no candidate could be flown.
    """
    spec = robot.spec
    least = max(relative_degree, 4 if architecture == "preview" else 1)
    horizons = sorted({max(least, round(s / spec.sample_time_s)) for s in candidates_s})
    names = robot.state_names if architecture == "state" else robot.state_names[:1]
    layouts = [
        InverseLayout(
            architecture=architecture,
            states=names,
            sample_time_s=spec.sample_time_s,
            horizon_samples=horizon,
        )
        for horizon in horizons
    ]
    trials = tuple(
        Trial(layout.horizon_samples, _worst_error(robot, record, path, limits, layout, axes))
        for layout in reversed(layouts)
    )[::-1]
    best = min(trial.rms_error for trial in trials)
    if not math.isfinite(best):
        raise RobotError("the robot could not be flown with an inverse of any horizon")
    alike = [i for i, trial in enumerate(trials) if trial.rms_error <= _CLOSE * best]
    return HorizonChoice(layouts[alike[-1 if architecture == "state" else 0]], trials)


def _worst_error(
    robot: Robot,
    record: FlightRecord,
    path: FloatArray,
    limits: TrackingLimits,
    layout: InverseLayout,
    axes: tuple[int, ...],
) -> float:
    inverse = LinearInverse(*pooled_pairs(layout, record, axes))
    worst = 0.0
    for candidate in (inverse, _Eager(inverse)) if layout.architecture == "state" else (inverse,):
        process = OnlineGp(layout, (candidate,) * path.shape[1], window=0)
        worst = max(worst, track(robot, path, limits, Learner(layout, process)).rms_error)
        if not math.isfinite(worst):
            # A robot that failed has to be picked up before it can fly again.
            robot.disconnect()
            robot.connect()
            break
    return worst


def pooled_pairs(
    layout: InverseLayout, record: FlightRecord, axes: tuple[int, ...]
) -> tuple[FloatArray, FloatArray]:
    """Return the training pairs of several axes of a record, one axis after another."""
    width = len(layout.states)
    pairs = [layout.pairs(record.references[:, i], record.states[:, i, :width]) for i in axes]
    return np.concatenate([x for x, _ in pairs]), np.concatenate([g for _, g in pairs])
