"""Pools the variances of a test's tones, since few segments measure each variance poorly."""

from __future__ import annotations

import numpy as np
from scipy.special import digamma, polygamma

from nufleet.shared.arrays import FloatArray

TREND_TONES_MIN = 4
DEGREES_MAX = 1e3

DEGREES_SPARE_MIN = 0.5
"""Lower bound of the degrees of freedom beyond 2, since a t distribution has no variance at 2."""


def pooled_variance(
    omega_rad_s: FloatArray, variance: FloatArray, degrees: FloatArray
) -> FloatArray:
    """Return variances of ẑ that borrow strength from the test's other tones.

    The values ln s² scatter about a line in ln ω, because the colour of the noise and the weights
    of the tones both follow roughly powers of ω. The scatter of the true variances about the line
    is the excess of the observed scatter over that of the χ² distribution of s² (empirical Bayes,
    Smyth, Stat. Appl. Genet. Mol. Biol. 3, 2004). The remaining uncertainty of a variance inflates
    it, as in a t distribution.

    Args:
        omega_rad_s: Frequencies in rad/s, shape (tones,).
        variance: Measured variance s² of each ẑ, shape (tones,), finite.
        degrees: Degrees of freedom of each s², shape (tones,).

    Returns:
        Pooled variances, shape (tones,).
    """
    tones = len(variance)
    if tones < TREND_TONES_MIN or not np.all(variance > 0):
        # Noise-free estimates have no scatter to learn from, and few tones give no line: each
        # variance stands alone, inflated to that of a t distribution, d / (d − 2).
        return np.asarray(variance * degrees / np.maximum(degrees - 2, DEGREES_SPARE_MIN))
    # E ln s² = ln σ² + ψ(d/2) − ln(d/2) for s² with d degrees of freedom, ψ the digamma function.
    log_variance = np.log(variance) - digamma(degrees / 2) + np.log(degrees / 2)
    line = np.stack([np.ones(tones), np.log(omega_rad_s)], axis=1)
    fitted = line @ np.linalg.lstsq(line, log_variance, rcond=None)[0]
    scatter = float(np.sum((log_variance - fitted) ** 2)) / (tones - 2)
    # Var ln s² = ψ'(d/2) + ψ'(d₀/2), which is solved for the prior degrees of freedom d₀.
    excess = scatter - float(np.mean(polygamma(1, degrees / 2)))
    prior_degrees = min(2 * _inverse_trigamma(excess), DEGREES_MAX) if excess > 0 else DEGREES_MAX
    # The line itself is known no better than all tones together determine it.
    prior_degrees = min(prior_degrees, float(np.mean(degrees)) * (tones - 2))
    total = prior_degrees + degrees
    pooled = (prior_degrees * np.exp(fitted) + degrees * variance) / total
    # The posterior of ẑ is a t distribution with d₀ + d degrees of freedom; this is its variance.
    return np.asarray(pooled * total / (total - 2))


def _inverse_trigamma(value: float) -> float:
    """Return x with ψ'(x) = `value`, by Newton's method on 1/ψ', which is nearly linear (Smyth)."""
    x = 0.5 + 1 / value
    for _ in range(50):
        trigamma = float(polygamma(1, x))
        step = trigamma * (1 - trigamma / value) / float(polygamma(2, x))
        x += step
        if abs(step) < 1e-8 * x:
            break
    return x
