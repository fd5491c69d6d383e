"""An interval for ψ(ω) from samples of two responses: within [0, 1], and 0 where they may agree."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance


def chordal_band(
    z_1: ComplexArray, z_2: ComplexArray, delta: float = 0.05
) -> tuple[FloatArray, FloatArray]:
    """Return bounds that hold ψ at each frequency with probability 1 − δ.

    A distance is never negative, so samples of it lie above 0 even where both robots are the same.
    Where the disc that holds z₁ − z₂ with probability 1 − δ also holds 0, the lower bound is 0.

    Args:
        z_1: joint samples of one response, shape (samples, frequencies).
        z_2: the same of the other.
        delta: probability that the interval misses ψ.
    """
    psi = chordal_distance(z_1, z_2)
    low, high = np.quantile(psi, [delta / 2, 1 - delta / 2], axis=0)
    between = z_1 - z_2
    centre = between.mean(axis=0)
    reach = np.quantile(np.abs(between - centre), 1 - delta, axis=0)
    # There only the upper bound can be missed.
    touching = np.abs(centre) <= reach
    high = np.where(touching, np.quantile(psi, 1 - delta, axis=0), high)
    return np.where(touching, 0.0, low), high
