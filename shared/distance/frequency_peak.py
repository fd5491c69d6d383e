"""The largest value of a function of frequency whose level crossings are known algebraically."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import NufleetError


class PeakSearchError(NufleetError):
    """The search for a peak did not come to an end: the models are too badly scaled."""


@dataclass(frozen=True)
class Peak:
    """The largest value, and the frequency where it is reached (inf: in the limit)."""

    value: float
    omega_rad_s: float


_STEPS = 2.0 ** -np.arange(2, 34)
AROUND = np.concatenate([1 - _STEPS, [1.0], 1 + _STEPS])


def find_peak(
    evaluate: Callable[[FloatArray], FloatArray],
    crossings: Callable[[float], FloatArray],
    next_level: Callable[[float], float],
    seeds_rad_s: FloatArray,
    band_rad_s: tuple[float, float],
) -> Peak:
    """Maximise over a band by raising a level until nothing crosses it.

    Between neighbouring crossings of a level the function is either above or below it, so a look
    between them either finds a better level or shows that there is none (Boyd and Balakrishnan
    1990; Bruinsma and Steinbuch 1990). Every crossing that is only nearly one is looked at too, so
    that no tolerance decides what counts; the value returned was always evaluated, not inferred.

    Args:
        evaluate: the function at frequencies in rad/s, which may include the band's end inf.
        crossings: frequencies ≥ 0 where the function may equal a level, the true ones among them.
        next_level: the level to test above a value: how much higher a peak would have to be.
        seeds_rad_s: frequencies to look at first.
        band_rad_s: lowest and highest frequency, the latter possibly inf.

    Raises:
        PeakSearchError: no end after 100 levels.
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
            # Crossings this close to a peak are the least exact: look around it once more.
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
