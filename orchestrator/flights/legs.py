"""Drawings as trajectories of a robot, and the practice path for candidate horizons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.flights.labels import flight_label, path_label
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import drawing_names, find_drawing
from nufleet.shared.paths.trajectories import check_trajectory, travel
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits
from nufleet.shared.wire.messages import Description

TYPICAL_SPEED = 0.6
"""Speed of a typical path, as a share of the largest one."""
TYPICAL_S = 10.0
"""Duration of a typical path at its largest speed: long enough to show what learning online leaves
after its first seconds."""
WORKSPACE_SHARE = 0.8
"""Share of the workspace that a typical path takes, which leaves room for corrections."""
ACCELERATION_SHARE = 0.8
"""Fraction of the acceleration limit used when planning; the rest is headroom for corrections."""


@dataclass(frozen=True, eq=False)
class Leg:
    """One path to be flown with every inverse."""

    drawing: str
    """Name of the drawing."""
    speed: float
    """Largest speed on the path, in `unit` per second."""
    unit: str
    """Unit of the robot's axes."""
    desired: FloatArray
    """Desired positions in `unit`, one row per sample of the robot, shape (samples, axes)."""
    scale: float = 1.0
    """Factor on the points of the drawing."""

    @property
    def size(self) -> float:
        """Root mean square of the path about its mean, in `unit`."""
        return float(np.sqrt(np.sum(np.var(self.desired, axis=0))))

    @property
    def title(self) -> str:
        """What is flown, in words, such as "clover at 0.6 m/s"."""
        size = "" if self.scale == 1.0 else f", {100 * self.scale:.0f} % as large,"
        return f"{self.drawing}{size} at {self.speed:g} {self.unit}/s"

    def extent_text(self, spec: RobotSpec) -> str:
        """Return how long and how far the path leads, in words."""
        flown_s = len(self.desired) * spec.sample_time_s
        furthest = float(np.abs(self.desired).max())
        return f"{self.title}: {flown_s:.1f} s, up to {furthest:.2f} {self.unit} from the origin"

    def label(self, inverse: str) -> str:
        """Return the name of a flight along this path with an inverse; see `flight_label`."""
        return flight_label(inverse, path_label(self.drawing, self.speed, self.unit))


def tracking_limits(spec: RobotSpec, robot: str) -> TrackingLimits:
    """Return a robot's tracking limits; raises InvalidInputError when it does not track."""
    if spec.tracking is None:
        units = sorted({axis.unit for axis in spec.axes})
        if len(units) > 1:
            raise InvalidInputError(
                f"robot {robot} flies no paths, since its axes are in {' and '.join(units)} and a "
                "path has one unit: `nufleet rank` compares all of its axes, and what flies or "
                "learns needs a robot whose axes have one unit"
            )
        raise InvalidInputError(
            f"robot {robot} has no tracking limits in its spec and cannot track; choose another "
            "robot, or add `tracking` to the spec of its driver"
        )
    return spec.tracking


def trajectory(points: FloatArray, speed: float, spec: RobotSpec, robot: str) -> FloatArray:
    """Return a drawing as the path of a robot, from rest to rest.

    A robot with one axis follows the drawing's x; axes beyond the second stay at zero. A robot with
    joints takes the drawing's numbers as angles in rad.

    Args:
        points: Points of the drawing in the unit of the robot's axes, shape (n, 2).
        speed: Largest speed on the path, in that unit per second.
        spec: Spec of the robot, with its tracking limits and sample time.
        robot: Name of the robot, for error messages.

    Returns:
        Desired positions, one row per sample of the robot, shape (samples, axes).

    Raises:
        InvalidInputError: The drawing leaves the workspace, or is faster than the robot may go.
    """
    limits = tracking_limits(spec, robot)
    unit = spec.axes[0].unit
    if speed > limits.speed_max:
        raise InvalidInputError(
            f"{speed:g} {unit}/s is faster than robot {robot} may go along a path: choose a speed "
            f"of at most {limits.speed_max:g} {unit}/s"
        )
    axes = len(spec.axes)
    columns = np.zeros((len(points), axes))
    columns[:, : min(2, axes)] = points[:, : min(2, axes)]
    acceleration = ACCELERATION_SHARE * limits.acceleration_max
    try:
        path = travel(columns, speed, acceleration, spec.sample_time_s)
        _check_workspace(path, limits.position_max, unit)
        check_trajectory(path, spec.sample_time_s, limits)
    except InvalidInputError as error:
        raise InvalidInputError(f"robot {robot} cannot fly it: {error}") from error
    return path


def _check_workspace(path: FloatArray, position_max: float, unit: str) -> None:
    furthest = float(np.abs(path).max())
    if furthest > position_max:
        percent = math.floor(100 * position_max / furthest)
        raise InvalidInputError(
            f"it reaches {furthest:.3g} {unit} from the origin, outside the workspace of "
            f"±{position_max:g} {unit}: move it, or make it at most {percent} % as large (--scale)"
        )


def read_drawings(drawings: Sequence[str]) -> dict[str, FloatArray]:
    """Return the points of drawings that are given by path or by name.

    Args:
        drawings: Paths of files, or names of installed drawings.

    Returns:
        Points of each drawing in m, shape (n, 2), by the drawing's name.

    Raises:
        InvalidInputError: A drawing cannot be read, or two have the same name.
    """
    points: dict[str, FloatArray] = {}
    for drawing in drawings:
        file = find_drawing(drawing)
        if file.stem in points:
            raise InvalidInputError(
                f"two drawings are called {file.stem}: name each once, or rename one, so that "
                "their flights can be distinguished"
            )
        points[file.stem] = read_drawing(file)
    return points


def legs_of(
    drawings: Mapping[str, FloatArray],
    speeds: Sequence[float],
    target: Description,
    *,
    scale: float = 1.0,
) -> tuple[Leg, ...]:
    """Return every drawing at every speed, as paths of a robot.

    Args:
        drawings: Points of each drawing, shape (n, 2), by its name.
        speeds: Largest speeds to fly at, in the unit of the robot's axes per second.
        target: Description of the robot that flies.
        scale: Factor on the points of every drawing.

    Returns:
        One leg per drawing and speed; the speeds of one drawing follow each other.

    Raises:
        InvalidInputError: The robot cannot fly one of them, or a speed is given twice.
    """
    if len(set(speeds)) != len(speeds):
        raise InvalidInputError("a speed is named twice: name each once")
    return tuple(
        Leg(
            drawing=name,
            speed=speed,
            unit=target.spec.axes[0].unit,
            desired=_named(name, scale * points, speed, target),
            scale=scale,
        )
        for name, points in drawings.items()
        for speed in speeds
    )


def typical_leg(target: Description) -> Leg:
    """Return a path that a robot may fly, for questions about no path in particular.

    It is an installed drawing, small enough for the robot's workspace and for `TYPICAL_S`, and
    drawn at a good part of the robot's largest speed.

    Args:
        target: Description of the robot.

    Raises:
        InvalidInputError: The robot does not track, or no drawing is installed.
    """
    limits = tracking_limits(target.spec, target.robot)
    name = next(iter(drawing_names()), None)
    if name is None:
        raise InvalidInputError("no drawing is installed: name one with --trajectory")
    points = read_drawing(find_drawing(name))
    speed = float(f"{TYPICAL_SPEED * limits.speed_max:.2g}")
    reach = WORKSPACE_SHARE * limits.position_max / float(np.abs(points).max())
    length = float(np.sum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    scale = float(f"{min(1.0, reach, TYPICAL_S * speed / length):.2g}")
    (leg,) = legs_of({name: points}, (speed,), target, scale=scale)
    return leg


def _named(name: str, points: FloatArray, speed: float, target: Description) -> FloatArray:
    try:
        return trajectory(points, speed, target.spec, target.robot)
    except InvalidInputError as error:
        raise InvalidInputError(f"{name}: {error}") from error


def practice_path(spec: RobotSpec, robot: str) -> FloatArray:
    """Return a Lissajous figure through most of the workspace, to practise on.

    Robots never practise on a drawing, so that the drawings remain unseen test data.

    Args:
        spec: Spec of the robot, with its tracking limits and sample time.
        robot: Name of the robot, for error messages.

    Returns:
        Desired positions in the unit of the axes, shape (samples, axes). Axis i follows
        sin((i + 2) φ), so that no two axes move together.

    Raises:
        InvalidInputError: The robot has no tracking limits.
    """
    limits = tracking_limits(spec, robot)
    phase = np.linspace(0.0, 2 * np.pi, 400)
    points = np.stack([np.sin((i + 2) * phase) for i in range(len(spec.axes))], axis=1)
    speed, acceleration = 0.7 * limits.speed_max, ACCELERATION_SHARE * limits.acceleration_max
    return travel(0.6 * limits.position_max * points, speed, acceleration, spec.sample_time_s)
