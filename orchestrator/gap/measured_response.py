"""A measured frequency response, and how far it is from another response over a band."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance, chordal_variance
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.models.transfer_models import ModelError, StateSpace

VARIANCE_MIN = 1e-150
"""A smaller variance counts as this one, so that a weight is finite."""


class BandError(InvalidInputError):
    """A band in which there is nothing to compare."""


@dataclass(frozen=True, eq=False)
class MeasuredResponse:
    """z(ω) at rising frequencies, shape (k,), with E|ẑ − z|² where it is known."""

    omega_rad_s: FloatArray
    z: ComplexArray
    variance: FloatArray | None = None

    def at(self, omega_rad_s: FloatArray) -> tuple[ComplexArray, FloatArray]:
        """Return z and its variance between the measured points: linear in ω, errors independent.

        The variance is 0 where none is known.
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
    """Return what a robot's tests found together: usable ones, repeated frequencies averaged.

    Weights are the inverse variances.

    Raises:
        InvalidInputError: no test is usable.
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
    """max ψ over the compared points of a band; `standard_deviation` is 0 where none is known.

    It is a lower bound of the ν-gap of the two systems, which also depends on all other frequencies
    and on the winding condition.
    """

    value: float
    omega_rad_s: float
    band_rad_s: tuple[float, float]
    points: int
    standard_deviation: float


def band_distance(
    first: MeasuredResponse | StateSpace,
    second: MeasuredResponse | StateSpace,
    band_rad_s: tuple[float, float] | None = None,
) -> BandDistance:
    """Compare two responses, at least one of them measured, where both are known.

    Looks at every measured frequency in the common band and at the band's ends; between its points
    a measured response is interpolated, a model is exact.

    Raises:
        BandError: a band of no width, or none that is common to all.
        ModelError: a model with more than one input or output.
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
            f" {described[1]}{asked}; these do not overlap: measure both over one band"
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
