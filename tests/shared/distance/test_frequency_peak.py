"""The level search finds the highest of several peaks, and the ends of the band."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.frequency_peak import PeakSearchError, find_peak

PEAKS = ((2.0, 1.0, 0.3), (40.0, 1.0 + 1e-6, 1e-3), (700.0, 0.9, 50.0))  # where, height, width


def bumps(omega: FloatArray) -> FloatArray:
    return np.asarray(sum(h / (1 + ((omega - w) / width) ** 2) for w, h, width in PEAKS))


def crossings(level: float) -> FloatArray:
    """Return the roots of bumps = level: the numerator's, as a polynomial in ω."""
    factors = [np.array([1.0, -2 * w, w**2 + width**2]) for w, _, width in PEAKS]
    left: FloatArray = -level * np.polymul(np.polymul(factors[0], factors[1]), factors[2])
    for i, (_, height, width) in enumerate(PEAKS):
        others = [factor for j, factor in enumerate(factors) if j != i]
        left = np.asarray(np.polyadd(left, height * width**2 * np.polymul(*others)), float)
    return np.asarray(np.abs(np.roots(left).real))


def test_the_highest_peak_is_found_from_a_seed_beside_a_lower_one() -> None:
    peak = find_peak(bumps, crossings, lambda v: v + 1e-9, np.array([2.0]), (0.0, np.inf))
    assert peak.omega_rad_s == pytest.approx(40.0, abs=1e-5)
    assert peak.value == pytest.approx(bumps(np.array([40.0]))[0], abs=1e-9)


def test_a_peak_outside_the_band_does_not_count() -> None:
    peak = find_peak(bumps, crossings, lambda v: v + 1e-9, np.empty(0), (3.0, 39.0))
    assert peak.omega_rad_s == 3.0
    assert peak.value == bumps(np.array([3.0]))[0]


def test_a_peak_that_crossings_only_come_near_is_still_climbed() -> None:
    def inexact(level: float) -> FloatArray:
        return crossings(level) * (1 + 1e-5)

    peak = find_peak(bumps, inexact, lambda v: v + 1e-9, np.array([40.01]), (30.0, 50.0))
    assert peak.value == pytest.approx(bumps(np.array([40.0]))[0], abs=1e-7)


def test_a_search_that_never_ends_says_so() -> None:
    heights = iter(range(10_000))

    def rising(omega: FloatArray) -> FloatArray:
        return np.full(len(omega), float(next(heights)))

    with pytest.raises(PeakSearchError, match="100 steps"):
        find_peak(rising, lambda _: np.array([1.0]), lambda v: v, np.empty(0), (0.0, 2.0))
