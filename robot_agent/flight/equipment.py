"""What acts in front of a robot on a flight along a path: inverse model, guard and fallback."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.robot_agent.flight.forecast import Forecast
from nufleet.robot_agent.flight.guard import Guard
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.mixture_learner import mixture_learner
from nufleet.robot_agent.flight.online_gp import WINDOW_POINTS, OnlineGp
from nufleet.robot_agent.flight.prior_learner import prior_learner
from nufleet.robot_agent.flight.tracking import Ahead, Learner
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotError
from nufleet.shared.wire.motions import Tracking


@dataclass(frozen=True, eq=False)
class Equipment:
    """What acts in front of a robot on one flight along a path."""

    learner: Learner | Ahead | None
    """Inverse model, or corrections known ahead; None for the baseline alone."""
    guard: Guard | None
    """Guard over the learner; None if the flight is not guarded."""
    fallback: Ahead | None
    """Corrections that take over if the guard withdraws those of the learner."""


def equipment_for(
    motion: Tracking, robot: Robot, memory: Memory, forecast: Forecast | None
) -> Equipment:
    """Return what a flight asks for, new and ready to fly.

    For the arguments and errors see `learner_for`.

    Raises:
        RobotError: In addition, the flight is guarded and the robot knows nothing of its baseline.
    """
    learner = learner_for(motion, robot, memory, forecast)
    if learner is None or not motion.guarded:
        return Equipment(learner, None, None)
    if forecast is None:
        raise RobotError("the robot does not know its baseline any more")
    fallback = None
    if forecast.own_helps and motion.inverse != "own":
        fallback = Ahead(forecast.correction, forecast.way.feedback)
    guard = guard_for(forecast, robot, fallback=fallback is not None)
    return Equipment(learner, guard, fallback)


def learner_for(
    motion: Tracking, robot: Robot, memory: Memory, forecast: Forecast | None
) -> Learner | Ahead | None:
    """Return the inverse model that a flight asks for, compiled and ready.

    Axes on which the prior was not learned begin with a zero prior.

    Args:
        motion: Flight requested.
        robot: The robot that flies it.
        memory: Memory of the robot, with its prior.
        forecast: What the robot's model of itself says of the path; None without a model.

    Returns:
        The learner, or corrections known ahead; None for the baseline alone.

    Raises:
        RobotError: The flight asks for a prior that the robot no longer has, or for its model of
            itself when it has none.
    """
    if motion.inverse == "baseline":
        return None
    if motion.inverse == "own":
        if forecast is None:
            raise RobotError("the robot has no model of itself any more")
        return Ahead(forecast.correction, forecast.way.feedback)
    window = WINDOW_POINTS if motion.learn else 0
    axes = robot.spec.axes
    if motion.mixture:
        return mixture_learner(motion, tuple(axis.name for axis in axes), memory, window)
    if motion.layout is not None:
        process = OnlineGp(motion.layout, (None,) * len(axes), window=window)
        return Learner(motion.layout, process)
    return prior_learner(motion, tuple(axis.name for axis in axes), memory, window)


def guard_for(forecast: Forecast, robot: Robot, *, fallback: bool) -> Guard:
    """Return the guard of one flight along a path.

    Args:
        forecast: What the robot's model of itself says of the path.
        robot: The robot that flies it.
        fallback: Whether corrections that are withdrawn give way to those of the robot's own model.

    Raises:
        RobotError: The robot has no tracking limits.
    """
    limits = robot.spec.tracking
    if limits is None:
        raise RobotError("the robot does not track")
    return Guard(
        forecast.baseline_squares,
        forecast.noise_variance,
        robot.spec.sample_time_s,
        limits.acceleration_max,
        forecast.correction,
        correction_speed_max=limits.correction_speed_max,
        fallback=fallback,
        unit=robot.spec.axes[0].unit,
    )
