"""What robots would do, before any of them moves: each motion with its time, reach and speed. Pure.

References are computed by the functions that the robots use themselves. Where a robot chooses
something, or its inverse model corrects the reference, the limits of its spec are given instead.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from nufleet.orchestrator.flights.legs import Leg, practice_path, tracking_limits
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.references import approach, rich_references, step_references
from nufleet.shared.paths.trajectories import speeds_and_accelerations
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import AxisSpec
from nufleet.shared.strict import Document, Fraction, Name, NonNegative, Positive, Strict
from nufleet.shared.wire.messages import Description

POINTS_MAX = 300
"""Largest number of points that a planned motion keeps of its path."""


class PlannedMotion(Strict):
    """One motion of a robot, from rest at 0 to rest at 0."""

    robot: Name
    """Name of the robot."""
    simulated: bool
    """Whether the robot is simulated."""
    what: str
    """What it does, in words."""
    times: int = 1
    """How many times it does so, at most."""
    duration_s: Positive
    """Duration of the motion, once."""
    unit: str
    """Unit of the axes that move; both where they differ."""
    low: dict[Name, float]
    high: dict[Name, float]
    """Bounds of the reference on each axis that moves, in `unit`."""
    velocity: NonNegative
    """Largest velocity of the reference, in `unit`/s."""
    acceleration: NonNegative
    """Largest acceleration of the reference, in `unit`/s²."""
    length: NonNegative | None = None
    """How far the reference travels, in `unit`; None where the robot chooses its amplitude."""
    path: tuple[tuple[float, ...], ...] = ()
    """Positions on the way, in `unit`, one column per axis; empty where `length` is None."""
    measured: dict[Name, tuple[float | None, float | None]]
    """Lower and upper limit on what is measured, by axis, in `unit`; None for none."""


class PlannedRobot(Strict):
    """What all planned motions of one robot amount to."""

    robot: Name
    """Name of the robot."""
    simulated: bool
    """Whether the robot is simulated."""
    duration_s: NonNegative
    """Time that it moves, at most."""
    battery: Fraction | None = None
    """Charge of its battery now; None if unknown."""
    endurance_s: NonNegative | None = None
    """Time that its battery lasts; None if unknown."""
    battery_used: NonNegative | None = None
    """Charge that the motions use, of a full battery's 1; more than `battery` needs a change of
    batteries. None if unknown."""


class Outlook(Document):
    """The document that a command with `--plan --json` prints."""

    headline: str
    """What is planned, in words."""
    later: str = ""
    """What follows and cannot be told yet, in words; empty for nothing."""
    motions: tuple[PlannedMotion, ...]
    """All planned motions; different robots may move at the same time."""
    robots: tuple[PlannedRobot, ...] = ()
    """All robots that move; see `with_healths`."""

    def with_healths(self, healths: Mapping[str, Health | None]) -> Outlook:
        """Return the same outlook with the sums of each robot, given the healths that are known."""
        every = dict.fromkeys(motion.robot for motion in self.motions)
        return self.model_copy(
            update={"robots": tuple(self._sum(robot, healths.get(robot)) for robot in every)}
        )

    def _sum(self, robot: str, health: Health | None) -> PlannedRobot:
        own = [motion for motion in self.motions if motion.robot == robot]
        duration_s = sum(motion.times * motion.duration_s for motion in own)
        battery = None if health is None else health.battery
        endurance_s = None if health is None else health.endurance_s
        used = None
        if battery is not None and endurance_s:
            used = battery * duration_s / endurance_s
        return PlannedRobot(
            robot=robot,
            simulated=own[0].simulated,
            duration_s=duration_s,
            battery=battery,
            endurance_s=endurance_s,
            battery_used=used,
        )


def check_healths(planned: Outlook, healths: Mapping[str, Health | None]) -> None:
    """Refuse motions of robots that are not ready, or whose battery does not last for one of them.

    Raises:
        InvalidInputError: At least one robot cannot move; all of them are named.
    """
    wrong = []
    for motion in planned.motions:
        health = healths.get(motion.robot)
        if health is None:
            continue
        if not health.ready:
            wrong.append(f"{motion.robot} is not ready: {health.reason}")
        elif health.endurance_s is not None and health.endurance_s < motion.duration_s:
            wrong.append(
                f"{motion.robot} would move for {motion.duration_s:.3g} s, and its battery lasts "
                f"for {health.endurance_s:.3g} s"
            )
    if wrong:
        raise InvalidInputError(f"{'; '.join(dict.fromkeys(wrong))}; nothing has moved")


def path_motion(target: Description, leg: Leg, *, corrected: bool, times: int = 1) -> PlannedMotion:
    """Return a flight along a path, with the approach to its start.

    Args:
        target: Description of the robot.
        leg: Path.
        corrected: Whether an inverse model corrects the reference.
        times: How many times it is flown.
    """
    return _along(target, leg.title, leg.desired, corrected=corrected, times=times)


def lesson_motions(
    learner: Description, *, duration_s: float, seed: int, trials: int
) -> tuple[PlannedMotion, ...]:
    """Return the motions from which a robot learns an experience.

    Args:
        learner: Description of the robot.
        duration_s: Duration of the rich flight.
        seed: Seed of the rich flight.
        trials: Largest number of flights that choose a horizon.

    Raises:
        InvalidInputError: The robot does not track.
    """
    practice = practice_path(learner.spec, learner.robot)
    return (
        rich_motion(learner, duration_s=duration_s, seed=seed),
        *(_steps(learner, column) for column in range(len(learner.spec.axes))),
        _along(learner, "practice path, one per horizon", practice, corrected=True, times=trials),
    )


def rich_motion(
    robot: Description, *, duration_s: float, seed: int, times: int = 1
) -> PlannedMotion:
    """Return a rich flight; raises InvalidInputError for a robot that does not track."""
    tracking_limits(robot.spec, robot.robot)
    references = rich_references(robot.spec, duration_s, np.random.default_rng(seed))
    return _motion(robot, "rich flight", references, times=times)


def _steps(robot: Description, column: int) -> PlannedMotion:
    references = step_references(robot.spec, column)
    return _motion(robot, f"steps on {robot.spec.axes[column].name}", references, columns=(column,))


def _along(
    robot: Description, what: str, desired: FloatArray, *, corrected: bool, times: int
) -> PlannedMotion:
    limits = tracking_limits(robot.spec, robot.robot)
    references = np.concatenate([approach(robot.spec, desired, limits), desired])
    slack, speed = (limits.correction_max, limits.correction_speed_max) if corrected else (0.0, 0.0)
    return _motion(robot, what, references, times=times, slack=slack, speed=speed)


def _motion(
    robot: Description,
    what: str,
    references: FloatArray,
    *,
    columns: Sequence[int] | None = None,
    times: int = 1,
    slack: float = 0.0,
    speed: float = 0.0,
) -> PlannedMotion:
    """Return a motion along references, shape (samples, axes).

    Args:
        robot: Description of the robot.
        what: What it does, in words.
        references: References in the unit of the axes, shape (samples, axes).
        columns: Axes that move; None for all.
        times: How many times it does so.
        slack: How far the references may be corrected on each axis, in that unit.
        speed: How fast a correction may change, in that unit per second.
    """
    spec = robot.spec
    axes = [spec.axes[i] for i in (range(len(spec.axes)) if columns is None else columns)]
    moved = references if columns is None else references[:, list(columns)]
    speeds, accelerations = speeds_and_accelerations(moved, spec.sample_time_s)
    kept = np.linspace(0, len(moved) - 1, min(POINTS_MAX, len(moved))).round().astype(int)
    return PlannedMotion(
        robot=robot.robot,
        simulated=spec.simulated,
        what=what,
        times=times,
        duration_s=len(moved) * spec.sample_time_s + spec.settling_time_s,
        unit=unit_of(axes),
        low={axis.name: float(moved[:, i].min() - slack) for i, axis in enumerate(axes)},
        high={axis.name: float(moved[:, i].max() + slack) for i, axis in enumerate(axes)},
        velocity=float(speeds.max()) + speed,
        acceleration=float(accelerations.max()),
        length=float(np.linalg.norm(np.diff(moved, axis=0), axis=1).sum()),
        path=tuple(tuple(map(float, point)) for point in moved[kept].round(4)),
        measured=measured_limits(axes),
    )


def unit_of(axes: Sequence[AxisSpec]) -> str:
    """Return the unit of some axes, or all of their units."""
    return " or ".join(dict.fromkeys(axis.unit for axis in axes))


def measured_limits(axes: Sequence[AxisSpec]) -> dict[str, tuple[float | None, float | None]]:
    """Return the limits on what is measured, by axis; see `PlannedMotion`."""
    return {axis.name: (axis.output_min, axis.output_max) for axis in axes}
