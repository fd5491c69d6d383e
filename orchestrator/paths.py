"""Drawings as trajectories of a robot, and the path that candidates practise on."""

from __future__ import annotations

import numpy as np

from shared.arrays import FloatArray
from shared.errors import InvalidInputError
from shared.robot_spec import RobotSpec, TrackingLimits
from shared.trajectories import check_trajectory, travel

ACCELERATION_SHARE = 0.8
"""Of the limit: what is left is for the corrections of the path."""


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


def practice_path(spec: RobotSpec, robot: str) -> FloatArray:
    """Return a Lissajous figure through most of the workspace, shape (samples, axes).

    No drawing is ever practised on: what is measured on drawings stays unseen.
    """
    limits = tracking_limits(spec, robot)
    phase = np.linspace(0.0, 2 * np.pi, 400)
    points = np.stack([np.sin((i + 2) * phase) for i in range(len(spec.axes))], axis=1)
    speed, acceleration = 0.7 * limits.speed_max, ACCELERATION_SHARE * limits.acceleration_max
    return travel(0.6 * limits.position_max * points, speed, acceleration, spec.sample_time_s)
