"""Variances of a test's tones that learn from each other: few segments measure each one poorly."""

from __future__ import annotations

import numpy as np
from scipy.special import digamma, polygamma

from nufleet.shared.arrays import FloatArray

TREND_TONES_MIN = 4
DEGREES_MAX = 1e3

DEGREES_SPARE_MIN = 0.5
"""A t distribution has a variance only above two degrees of freedom; near there it is bounded."""


def pooled_variance(
    omega_rad_s: FloatArray, variance: FloatArray, degrees: FloatArray
) -> FloatArray:
    """Return variances of ẑ that borrow strength from the test's other tones.

    Each ln s² scatters about a line in ln ω: noise is coloured and tones have unequal weights, both
    roughly by powers of ω. How far the truth scatters about the line follows from how much more s²
    scatters than its χ² distribution says (Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004). What
    is still unknown of a variance is added to it, as in a t distribution.

    Args:
        omega_rad_s: shape (tones,).
        variance: of each ẑ, as measured, shape (tones,), finite.
        degrees: its degrees of freedom, shape (tones,).
    """
    tones = len(variance)
    if tones < TREND_TONES_MIN or not np.all(variance > 0):
        # Noise-free estimates have no scatter to learn from; a lone one keeps its own.
        return np.asarray(variance * degrees / np.maximum(degrees - 2, DEGREES_SPARE_MIN))
    log_variance = np.log(variance) - digamma(degrees / 2) + np.log(degrees / 2)
    line = np.stack([np.ones(tones), np.log(omega_rad_s)], axis=1)
    fitted = line @ np.linalg.lstsq(line, log_variance, rcond=None)[0]
    scatter = float(np.sum((log_variance - fitted) ** 2)) / (tones - 2)
    excess = scatter - float(np.mean(polygamma(1, degrees / 2)))
    prior_degrees = min(2 * _inverse_trigamma(excess), DEGREES_MAX) if excess > 0 else DEGREES_MAX
    # The line itself is known no better than all tones together know it.
    prior_degrees = min(prior_degrees, float(np.mean(degrees)) * (tones - 2))
    total = prior_degrees + degrees
    pooled = (prior_degrees * np.exp(fitted) + degrees * variance) / total
    return np.asarray(pooled * total / (total - 2))


def _inverse_trigamma(value: float) -> float:
    """Return x with ψ'(x) = value, by Newton's method on 1/ψ', which is nearly straight."""
    x = 0.5 + 1 / value
    for _ in range(50):
        trigamma = float(polygamma(1, x))
        step = trigamma * (1 - trigamma / value) / float(polygamma(2, x))
        x += step
        if abs(step) < 1e-8 * x:
            break
    return x
