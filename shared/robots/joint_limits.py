"""What limits axes that move together, beyond the limits that each of them has by itself.

The limits of the axes are the half-axes of an ellipsoid, Σ (v_i / v_i,max)² ≤ 1 for velocities, and
likewise for accelerations. In every direction, axes with equal limits together are thus no faster,
and accelerate no harder, than one of them alone may; axes in different units can be added.
Positions are limited on each axis alone: a workspace is as wide in its corners as on its axes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.spec import AxisSpec

HEADROOM = 0.8
"""Share of the tightest limit used when the robot chooses the amplitude itself."""


def joint_share(
    velocities: FloatArray, accelerations: FloatArray, axes: Sequence[AxisSpec]
) -> float:
    """Return the largest factor, at most 1, by which all axes may scale a motion to keep limits.

    Args:
        velocities: Velocity of each axis at each sample, shape (samples, axes), in unit/s.
        accelerations: Acceleration of each axis at each sample, shape (samples, axes), in unit/s².
        axes: The axes, with their limits.
    """
    fastest = np.array([axis.velocity_max for axis in axes])
    hardest = np.array([axis.acceleration_max for axis in axes])
    used = max(
        float(np.max(np.linalg.norm(velocities / fastest, axis=1))),
        float(np.max(np.linalg.norm(accelerations / hardest, axis=1))),
    )
    return 1.0 if used <= 1.0 or len(axes) == 1 else 1.0 / used
