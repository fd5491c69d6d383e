"""A measured frequency response, and its distance from another response over a band."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance, chordal_variance
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.transfer_models import ModelError, StateSpace

if TYPE_CHECKING:
    from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

VARIANCE_MIN = 1e-150
"""Lower bound of a variance, which keeps its inverse, the weight, finite."""


class BandError(InvalidInputError):
    """A band in which two responses cannot be compared."""


@dataclass(frozen=True, eq=False)
class MeasuredResponse:
    """A frequency response that was measured at some frequencies."""

    omega_rad_s: FloatArray
    """Frequencies in rad/s, rising, shape (k,)."""
    z: ComplexArray
    """Response at each frequency, shape (k,)."""
    variance: FloatArray | None = None
    """Variance E|ẑ − z|² at each frequency, shape (k,); None if it is not known."""

    def at(self, omega_rad_s: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Interpolate the response linearly in ω, with independent errors at the measured points.

        Args:
            omega_rad_s: Frequencies in rad/s within the measured range, shape (m,).

        Returns:
            Response z and its variance, each of shape (m,); the variance is 0 if it is not known.
        """
        right = np.searchsorted(self.omega_rad_s, omega_rad_s).clip(1, len(self.omega_rad_s) - 1)
        start, end = self.omega_rad_s[right - 1], self.omega_rad_s[right]
        share = (omega_rad_s - start) / (end - start)
        z = (1 - share) * self.z[right - 1] + share * self.z[right]
        if self.variance is None:
            return z, np.zeros(len(omega_rad_s))
        spread = (1 - share) ** 2 * self.variance[right - 1] + share**2 * self.variance[right]
        return z, spread


def combined(responses: Sequence[FrequencyResponse]) -> MeasuredResponse:
    """Combine all usable tests of a robot into one response.

    Estimates at the same frequency are averaged with the inverse variances as weights.

    Args:
        responses: Responses of the robot's tests, unusable ones included.

    Raises:
        InvalidInputError: No test is usable.
    """
    usable = [response for response in responses if response.quality.usable]
    if not usable:
        raise InvalidInputError("none of the tests is usable: there is no response to write")
    omega, place = np.unique(
        np.concatenate([response.omega_rad_s for response in usable]), return_inverse=True
    )
    variance = np.concatenate([response.variance for response in usable])
    weight = 1 / np.maximum(variance, VARIANCE_MIN)
    z = np.concatenate([response.z for response in usable])
    total, sums = np.zeros(len(omega)), np.zeros(len(omega), np.complex128)
    np.add.at(total, place, weight)
    np.add.at(sums, place, weight * z)
    return MeasuredResponse(omega, np.asarray(sums / total), 1 / total)


@dataclass(frozen=True)
class BandDistance:
    """The largest chordal distance over a band (paper, eq. 6).

    It is a lower bound of the ν-gap of the two systems, which also depends on all other frequencies
    and on the winding condition.
    """

    value: float
    """Largest ψ over the compared frequencies, from 0 to 1."""
    omega_rad_s: float
    """Frequency of the largest distance in rad/s."""
    band_rad_s: tuple[float, float]
    """Lowest and highest compared frequency in rad/s."""
    points: int
    """Number of compared frequencies."""
    standard_deviation: float
    """Standard deviation of ψ at that frequency; 0 if no variance is known."""


def band_distance(
    first: MeasuredResponse | StateSpace,
    second: MeasuredResponse | StateSpace,
    band_rad_s: tuple[float, float] | None = None,
) -> BandDistance:
    """Compare two responses, at least one of them measured, over the band where both are known.

    The comparison covers every measured frequency in the common band and the band's ends. Between
    its points a measured response is interpolated; a model is evaluated exactly.

    Args:
        first: One response or model.
        second: The other response or model.
        band_rad_s: Lowest and highest frequency in rad/s; None takes the whole common band.

    Raises:
        BandError: The band has no width, or it does not overlap with both responses.
        ModelError: A model has more than one input or output.
    """
    low, high = (0.0, math.inf) if band_rad_s is None else band_rad_s
    if not 0 <= low < high or (band_rad_s is not None and math.isinf(high)):
        raise BandError(f"a band needs 0 ≤ low < high < ∞ in rad/s, got {low:g} and {high:g}")
    described = []
    for response in (first, second):
        start, end = _range(response)
        described.append(f"{start:.6g} to {end:.6g} rad/s")
        low, high = max(low, start), min(high, end)
    asked = "" if band_rad_s is None else f" and the band {band_rad_s[0]:g} to {band_rad_s[1]:g}"
    if not low < high:
        raise BandError(
            f"nothing to compare: the responses are known from {described[0]} and from"
            f" {described[1]}{asked}; these do not overlap: measure both over the same band"
        )
    measured = [r.omega_rad_s for r in (first, second) if isinstance(r, MeasuredResponse)]
    omega = np.unique(np.concatenate([*measured, [low, high]]))
    omega = omega[(omega >= low) & (omega <= high)]
    (z1, variance1), (z2, variance2) = _at(first, omega), _at(second, omega)
    psi = chordal_distance(z1, z2)
    worst = int(np.argmax(psi))
    variance = float(chordal_variance(z1, variance1, z2, variance2)[worst])
    return BandDistance(
        float(psi[worst]), float(omega[worst]), (low, high), len(omega), math.sqrt(variance)
    )


def _range(response: MeasuredResponse | StateSpace) -> tuple[float, float]:
    if isinstance(response, MeasuredResponse):
        return float(response.omega_rad_s[0]), float(response.omega_rad_s[-1])
    if (response.outputs, response.inputs) != (1, 1):
        raise ModelError(
            "a measured response has one input and one output; the model has"
            f" {response.inputs} and {response.outputs}"
        )
    return 0.0, math.inf if response.dt_s == 0 else math.pi / response.dt_s


def _at(
    response: MeasuredResponse | StateSpace, omega_rad_s: FloatArray
) -> tuple[ComplexArray, FloatArray]:
    if isinstance(response, MeasuredResponse):
        return response.at(omega_rad_s)
    denominator, numerator = response.graph(omega_rad_s)[:, :, 0].T
    z = np.full(len(omega_rad_s), complex(math.inf))
    np.divide(numerator, denominator, out=z, where=denominator != 0)
    return z, np.zeros(len(omega_rad_s))
