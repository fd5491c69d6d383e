"""From MAVLink's frames to ours and back.

MAVLink measures in NED: x to the north, y to the east, z down, and yaw clockwise from the north. A
robot here is measured in ENU: x to the east, y to the north, z up, and yaw anticlockwise from the
east. Both are right-handed.
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray

_ORDER, _SIGNS = np.array([1, 0, 2]), np.array([1.0, 1.0, -1.0])


def enu_of_ned(vector: FloatArray) -> FloatArray:
    """Return a vector of one frame in the other, shape (..., 3); the same map leads back.

    Examples:
        >>> north_down = np.array([1.0, 0.0, 2.0])
        >>> print(enu_of_ned(north_down))
        [ 0.  1. -2.]
        >>> print(enu_of_ned(enu_of_ned(north_down)))
        [1. 0. 2.]
    """
    swapped: FloatArray = vector[..., _ORDER] * _SIGNS
    return swapped


ned_of_enu = enu_of_ned


def yaw_of_other_frame(yaw_rad: float) -> float:
    """Return a yaw of one frame in the other, in (−π, π]; the same map leads back.

    Examples:
        >>> round(math.degrees(yaw_of_other_frame(0.0)))  # the nose to the north is 90° in ENU
        90
        >>> round(math.degrees(yaw_of_other_frame(math.radians(180.0))))
        -90
    """
    turned = math.pi / 2 - yaw_rad
    return math.atan2(math.sin(turned), math.cos(turned))


def rotated(quaternion: FloatArray, vector: FloatArray) -> FloatArray:
    """Return a vector of the body's frame in the frame in which its attitude is given.

    Args:
        quaternion: Attitude (w, x, y, z) of the body, of length 1.
        vector: Vector in the body's frame, shape (3,).
    """
    w, axis = quaternion[0], quaternion[1:]
    crossed = 2.0 * np.cross(axis, vector)
    turned: FloatArray = vector + w * crossed + np.cross(axis, crossed)
    return turned
