"""Smooth paths on which a drone comes to rest."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray

SHORTEST_S = 0.1


def glide(
    start: FloatArray,
    velocity: FloatArray,
    *,
    velocity_max: float,
    acceleration_max: float,
    sample_time_s: float,
) -> tuple[FloatArray, FloatArray]:
    """Return the polynomial of fifth order from a point in motion to rest at zero.

    It ends without velocity and acceleration, and begins without acceleration.

    Args:
        start: Where it begins, shape (3,), in m.
        velocity: Velocity there, shape (3,), in m/s.
        velocity_max: Largest speed from rest, in m/s.
        acceleration_max: Largest acceleration from rest, in m/s².
        sample_time_s: Time between two points.

    Returns:
        Positions and velocities after each sample, both of shape (samples, 3).
    """
    far, fast = float(np.linalg.norm(start)), float(np.linalg.norm(velocity))
    # The largest slope and curvature of 10 s³ − 15 s⁴ + 6 s⁵ are 15/8 and 10/√3.
    lasts_s = max(
        SHORTEST_S,
        15 / 8 * far / velocity_max,
        math.sqrt(10 / math.sqrt(3) * far / acceleration_max),
        4 * fast / acceleration_max,
    )
    samples = math.ceil(lasts_s / sample_time_s)
    lasts_s = samples * sample_time_s
    s = (np.arange(1, samples + 1) / samples)[:, np.newaxis]
    position = start * (1 - 10 * s**3 + 15 * s**4 - 6 * s**5)
    position = position + velocity * lasts_s * (s - 6 * s**3 + 8 * s**4 - 3 * s**5)
    slope = start * (-30 * s**2 + 60 * s**3 - 30 * s**4) / lasts_s
    slope = slope + velocity * (1 - 18 * s**2 + 32 * s**3 - 15 * s**4)
    return position, slope
