"""What a record may hold besides its tones: which frequencies, and as sums of polynomials."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.polynomial.chebyshev import chebval

from nufleet.shared.frequency_test.transient_parts import distortion, ringing_parts


@pytest.mark.parametrize("tones", [6, 64])
def test_products_of_odd_harmonics_that_are_no_tones_are_even_or_higher(tones: int) -> None:
    base = 2 * np.pi
    of_two, of_three = distortion(base * np.arange(1, 2 * tones, 2))
    # As far as there are products below 120, and as far as the record resolves them.
    np.testing.assert_allclose(
        of_two.omega / base, np.arange(2, min(4 * tones - 2, 19) + 1, 2), atol=0.01
    )
    np.testing.assert_allclose(of_three.omega / base, np.arange(2 * tones + 1, 20, 2), atol=0.01)


def test_parts_are_the_oscillations_that_they_are_sums_of_polynomials_for() -> None:
    parts = ringing_parts(60.0)
    times = np.linspace(0, 1, 400)
    turning = np.exp(np.outer(times, 1j * parts.omega - parts.decay))
    real, imaginary = np.split(chebval(2 * times - 1, parts.both), 2)
    np.testing.assert_allclose(real.T, turning.real, atol=1e-10)
    np.testing.assert_allclose(imaginary.T, turning.imag, atol=1e-10)


def test_each_decay_rate_is_as_probable_as_any_other() -> None:
    parts = ringing_parts(10.0)
    rates = np.unique(parts.decay)
    of_rate = [parts.probability[parts.decay == rate].sum() for rate in rates]
    np.testing.assert_allclose(of_rate, 1 / len(rates))
