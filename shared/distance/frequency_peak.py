"""Maximisation of a function of frequency whose level crossings are known algebraically."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import NufleetError


class PeakSearchError(NufleetError):
    """The search for a peak did not terminate, because the models are too badly scaled."""


@dataclass(frozen=True)
class Peak:
    """The maximum of a function of frequency."""

    value: float
    """Largest value found."""
    omega_rad_s: float
    """Frequency that attains it; inf for the limit ω → ∞."""


# Relative frequencies around a peak, doubling their distance from it: 2⁻³³ to 2⁻².
_STEPS = 2.0 ** -np.arange(2, 34)
AROUND = np.concatenate([1 - _STEPS, [1.0], 1 + _STEPS])


def find_peak(
    evaluate: Callable[[FloatArray], FloatArray],
    crossings: Callable[[float], FloatArray],
    next_level: Callable[[float], float],
    seeds_rad_s: FloatArray,
    band_rad_s: tuple[float, float],
) -> Peak:
    """Maximise a function over a band by raising a level until the function no longer crosses it.

    Between neighbouring crossings of a level the function is either above or below it, so one
    evaluation between each pair either finds a higher level or shows that there is none (Boyd and
    Balakrishnan, Systems & Control Letters 15, 1990; Bruinsma and Steinbuch, Systems & Control
    Letters 14, 1990). Points that are only close to being crossings are evaluated too, so that the
    result depends on no tolerance. The value returned was always evaluated, never inferred.

    Args:
        evaluate: Function of frequencies in rad/s, shape (k,) to (k,); if the band ends at inf, it
            must accept inf.
        crossings: Function of a level that returns frequencies ≥ 0 in rad/s, shape (k,), which
            include all those at which `evaluate` equals the level.
        next_level: Function of the best value found that returns the next level to test, and thus
            sets the accuracy of the result.
        seeds_rad_s: Frequencies to evaluate first, shape (k,).
        band_rad_s: Lowest and highest frequency, the latter possibly inf.

    Returns:
        The maximum; no value in the band reaches `next_level` of it.

    Raises:
        PeakSearchError: the search did not terminate within 100 levels.
    """
    low, high = band_rad_s
    best = _best(evaluate, np.concatenate([seeds_rad_s, [low, high]]), band_rad_s)
    for _ in range(100):
        level = next_level(best.value)
        inside = _within(crossings(level), band_rad_s)
        top = high if np.isfinite(high) else 2 * inside.max(initial=low) + 1.0
        ends = np.concatenate([[low], np.sort(inside), [top]])
        found = _best(evaluate, np.concatenate([inside, (ends[1:] + ends[:-1]) / 2]), band_rad_s)
        if found.value > best.value:
            best = found
        if best.value < level:
            # Crossings are least exact close to a peak, where two of them merge, so its
            # surroundings are evaluated once more before the search ends.
            found = _best(evaluate, best.omega_rad_s * AROUND, band_rad_s)
            if found.value < level:
                return best if best.value > found.value else found
            best = found
    raise PeakSearchError("the peak over frequency was not found in 100 steps; rescale the models")


def _within(omega_rad_s: FloatArray, band_rad_s: tuple[float, float]) -> FloatArray:
    low, high = band_rad_s
    return omega_rad_s[(omega_rad_s >= low) & (omega_rad_s <= high)]


def _best(
    evaluate: Callable[[FloatArray], FloatArray],
    omega_rad_s: FloatArray,
    band_rad_s: tuple[float, float],
) -> Peak:
    inside = _within(omega_rad_s, band_rad_s)
    values = evaluate(inside)
    index = int(np.argmax(values))
    return Peak(float(values[index]), float(inside[index]))
