"""Drawings as trajectories of a robot, and the path that candidates practise on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from orchestrator.flight_labels import flight_label, path_label
from shared.arrays import FloatArray
from shared.drawing_files import read_drawing
from shared.drawings import find_drawing
from shared.errors import InvalidInputError
from shared.messages import Description
from shared.robot_spec import RobotSpec, TrackingLimits
from shared.trajectories import check_trajectory, travel

ACCELERATION_SHARE = 0.8
"""Of the limit: what is left is for the corrections of the path."""


@dataclass(frozen=True, eq=False)
class Leg:
    """One path to be flown with every inverse; `desired` has shape (samples, axes), in `unit`."""

    drawing: str
    speed: float
    unit: str
    desired: FloatArray

    def label(self, inverse: str) -> str:
        """Return what tells a flight along this path from others."""
        return flight_label(inverse, path_label(self.drawing, self.speed, self.unit))


def tracking_limits(spec: RobotSpec, robot: str) -> TrackingLimits:
    """Return a robot's tracking limits; raises InvalidInputError when it does not track."""
    if spec.tracking is None:
        raise InvalidInputError(
            f"robot {robot} has no tracking limits in its spec: it cannot track"
        )
    return spec.tracking


def trajectory(points: FloatArray, speed: float, spec: RobotSpec, robot: str) -> FloatArray:
    """Return a drawing (n, 2) as the path of a robot, shape (samples, axes), from rest to rest.

    A robot with one axis follows the drawing's x; axes beyond the second stay at zero. Angles of a
    joint robot take the drawing's numbers as rad.

    Raises:
        InvalidInputError: the drawing leaves the workspace, or is faster than the robot may go.
    """
    limits = tracking_limits(spec, robot)
    if speed > limits.speed_max:
        raise InvalidInputError(
            f"{speed:g} is faster than robot {robot} may go: {limits.speed_max:g}"
        )
    axes = len(spec.axes)
    columns = np.zeros((len(points), axes))
    columns[:, : min(2, axes)] = points[:, : min(2, axes)]
    path = travel(columns, speed, ACCELERATION_SHARE * limits.acceleration_max, spec.sample_time_s)
    try:
        check_trajectory(path, spec.sample_time_s, limits)
    except InvalidInputError as error:
        raise InvalidInputError(f"robot {robot}: {error}") from error
    return path


def legs_of(
    drawings: Sequence[str], speeds: Sequence[float], target: Description, *, scale: float = 1.0
) -> tuple[Leg, ...]:
    """Return every drawing, given by path or name, at every speed, as paths of a robot.

    Raises:
        InvalidInputError: a drawing cannot be read, or the robot cannot fly it.
    """
    files = [find_drawing(drawing) for drawing in drawings]
    return tuple(
        Leg(
            drawing=file.stem,
            speed=speed,
            unit=target.spec.axes[0].unit,
            desired=trajectory(scale * read_drawing(file), speed, target.spec, target.robot),
        )
        for file in files
        for speed in speeds
    )


def practice_path(spec: RobotSpec, robot: str) -> FloatArray:
    """Return a Lissajous figure through most of the workspace, shape (samples, axes).

    No drawing is ever practised on: what is measured on drawings stays unseen.
    """
    limits = tracking_limits(spec, robot)
    phase = np.linspace(0.0, 2 * np.pi, 400)
    points = np.stack([np.sin((i + 2) * phase) for i in range(len(spec.axes))], axis=1)
    speed, acceleration = 0.7 * limits.speed_max, ACCELERATION_SHARE * limits.acceleration_max
    return travel(0.6 * limits.position_max * points, speed, acceleration, spec.sample_time_s)
