"""What no linear response explains of a loop's motions: how much of it, and how it varies in time.

A sensor's noise changes from sample to sample; friction, coupling between axes and gusts last. The
autocovariance tells the two apart: lasting disturbances have a smooth one, and noise that is white
adds a peak at lag 0 alone.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.fft import irfft, rfft
from pydantic import Field

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import NonNegative, Strict

LAGS_MAX = 1000
"""Largest number of lags that are kept."""


_SURE = 2.0  # standard deviations of the correlation of noise that is white


class Unexplained(Strict):
    """Sums over flights of the products of what is unexplained on one axis, a lag apart.

    Those of several flights with the same number of lags add up.
    """

    products: Annotated[tuple[float, ...], Field(min_length=3, max_length=LAGS_MAX)]
    """Σ_k r(k) r(k + τ) for the lags τ = 0, 1, … in samples, in unit²."""
    rows: Annotated[int, Field(ge=1)]
    """Number of samples."""
    errors: NonNegative
    """Sum of the squared errors u − y of all axes in these flights, in unit²: the larger the
    motion, the more of it is left unexplained."""
    resting: NonNegative
    """Number of samples times the variance of the output at rest, in unit²."""

    @staticmethod
    def of(left: FloatArray, lags: int, error_square: float, rest_std: float) -> Unexplained:
        """Return what one flight shows.

        Args:
            left: Error that the response leaves unexplained, shape (samples,), in the axis's unit.
            lags: Number of lags to keep, at least three.
            error_square: Mean of the squared error u − y, summed over the axes, in unit².
            rest_std: Standard deviation of the output at rest, in the axis's unit.
        """
        products = np.zeros(lags)
        found = autocovariance(left[np.newaxis] - left.mean(), min(lags, len(left))) * len(left)
        products[: len(found)] = found
        return Unexplained(
            products=tuple(products.tolist()),
            rows=len(left),
            errors=error_square * len(left),
            resting=rest_std**2 * len(left),
        )

    def __add__(self, other: Unexplained) -> Unexplained:
        """Return the sums over the flights of both."""
        return Unexplained(
            products=tuple(a + b for a, b in zip(self.products, other.products, strict=True)),
            rows=self.rows + other.rows,
            errors=self.errors + other.errors,
            resting=self.resting + other.resting,
        )

    @property
    def error_square(self) -> float:
        """Mean of the squared error of these flights, summed over the axes, in unit²."""
        return self.errors / self.rows

    def parts(self) -> tuple[FloatArray, float]:
        """Return the autocovariance of what lasts, shape (lags,), and the variance of the noise.

        The noise is what lag 0 has beyond the line through lags 1 and 2. It is at least what the
        output varies by at rest, though the sensor may filter its noise: a controller that fought
        the noise of its sensor would move the robot for nothing.
        """
        total = np.array(self.products) / self.rows
        peak = float(np.clip(total[0] - (2 * total[1] - total[2]), 0.0, total[0]))
        noise = min(max(peak, self.resting / self.rows), float(total[0]))
        lasting = total.copy()
        lasting[0] -= peak
        # The part of the noise at rest that is not white is smooth, too: it has a share of what
        # seems to last.
        left = (total[0] - noise) / lasting[0] if lasting[0] > 0 else 0.0
        return lasting * left, noise

    def drawn(self, samples: int, rng: np.random.Generator) -> FloatArray:
        """Draw what may be left unexplained of another flight, shape (samples,)."""
        lasting, noise = self.parts()
        length = fast_length(samples + 2 * len(lasting))
        white = np.sqrt(noise) * rng.standard_normal(samples)
        power = spectrum(lasting, length)
        shaped = irfft(np.sqrt(power) * rfft(rng.standard_normal(length)), length)
        return np.asarray(white + shaped[:samples])


def spectrum(covariance: FloatArray, length: int) -> FloatArray:
    """Return the power of a process at the frequencies of `rfft` of a length, never negative.

    Args:
        covariance: Autocovariance, shape (lags,), with at most half as many lags as the length.
        length: Number of samples of the transform.
    """
    # A taper keeps the spectrum of few lags from becoming negative in most places.
    taper = 0.5 + 0.5 * np.cos(np.pi * np.arange(len(covariance)) / len(covariance))
    half = covariance * taper
    return np.asarray(np.maximum(2 * rfft(half, length).real - half[0], 0.0))


def correlation_samples(left: FloatArray) -> float:
    """Return how many samples what is unexplained lasts: 1 for white noise, otherwise more.

    Args:
        left: What is unexplained of one record, shape (samples,), without its mean.
    """
    samples = len(left)
    covariance = autocovariance(left[np.newaxis], min(samples, LAGS_MAX))
    if not covariance[0] > 0:
        return 1.0
    # Beyond the first lag that chance could explain, sums over the lags gather little but chance.
    shares = covariance[1:] / covariance[0]
    chance = np.flatnonzero(shares < _SURE / np.sqrt(samples))
    return float(1 + 2 * np.sum(shares[: chance[0] if len(chance) else len(shares)]))


def autocovariance(rows: FloatArray, lags: int) -> FloatArray:
    """Return the mean over rows of their products a lag apart, divided by their length.

    Args:
        rows: Signals, shape (signals, samples), whose mean square the first number is.
        lags: Number of lags, from 0.

    Returns:
        The autocovariance, shape (lags,).
    """
    samples = rows.shape[1]
    length = fast_length(samples + lags)
    power = np.mean(np.abs(rfft(rows, length)) ** 2, axis=0)
    return np.asarray(irfft(power, length)[:lags] / samples)


def fast_length(samples: int) -> int:
    """Return the least length of a fast transform: no prime factor but 2, 3 and 5.

    Args:
        samples: Length that it has at least.

    Examples:
        >>> fast_length(1), fast_length(7), fast_length(1025)
        (1, 8, 1080)
    """
    best = 1 << max(samples - 1, 0).bit_length()
    fives = 1
    while fives < best:
        threes = fives
        while threes < best:
            twos = 1 << (-(-samples // threes) - 1).bit_length()
            best = min(best, threes * twos)
            threes *= 3
        fives *= 5
    return best
