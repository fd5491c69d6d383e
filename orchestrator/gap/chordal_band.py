"""An interval for ψ(ω) from samples of two responses, which reaches 0 where they may agree."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance


def chordal_band(
    z_1: ComplexArray, z_2: ComplexArray, delta: float = 0.05
) -> tuple[FloatArray, FloatArray]:
    """Return bounds that contain ψ at each frequency with probability 1 − δ.

    A distance is never negative, so its samples lie above 0 even where both responses are equal.
    Where the disc that contains z₁ − z₂ with probability 1 − δ also contains 0, the lower bound is
    therefore set to 0.

    Args:
        z_1: Joint samples of one response, shape (samples, frequencies).
        z_2: Joint samples of the other response, in the same shape.
        delta: Probability δ that the interval misses ψ.

    Returns:
        Lower and upper bounds in [0, 1], each of shape (frequencies,).
    """
    psi = chordal_distance(z_1, z_2)
    low, high = np.quantile(psi, [delta / 2, 1 - delta / 2], axis=0)
    between = z_1 - z_2
    centre = between.mean(axis=0)
    reach = np.quantile(np.abs(between - centre), 1 - delta, axis=0)
    # Where 0 is the lower bound, only the upper one can be missed: it takes all of δ.
    touching = np.abs(centre) <= reach
    high = np.where(touching, np.quantile(psi, 1 - delta, axis=0), high)
    return np.where(touching, 0.0, low), high
