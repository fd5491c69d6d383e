"""Measured responses: what several tests found together, and distances over a common band."""

from __future__ import annotations

import math

import numpy as np
import pytest

from nufleet.orchestrator.gap.measured_response import (
    BandError,
    MeasuredResponse,
    band_distance,
    combined,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.distance.nu_gap import chordal_peak_in_band
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.models.realization import transfer_function, transfer_matrix
from nufleet.shared.models.transfer_models import ModelError

FIRST, SECOND = transfer_function([4], [1, 0.4, 4]), transfer_function([5], [1, 0.6, 5])


def measured(
    num: list[float], den: list[float], omega: FloatArray, variance: float | None = None
) -> MeasuredResponse:
    z = np.polyval(num, 1j * omega) / np.polyval(den, 1j * omega)
    return MeasuredResponse(omega, z, None if variance is None else np.full(len(omega), variance))


def test_densely_measured_responses_are_as_far_apart_as_their_models() -> None:
    one = measured([4], [1, 0.4, 4], np.linspace(0.5, 5, 4001))
    two = measured([5], [1, 0.6, 5], np.linspace(1, 7, 3001))
    exact = chordal_peak_in_band(FIRST, SECOND, (1.0, 5.0))
    for first, second in ((one, two), (one, SECOND), (FIRST, two)):
        found = band_distance(first, second, (1.0, 5.0))
        assert found.value == pytest.approx(exact.value, abs=1e-5)
        assert found.omega_rad_s == pytest.approx(exact.omega_rad_s, abs=5e-3)
        assert found.band_rad_s == (1.0, 5.0)


def test_only_the_common_band_counts() -> None:
    one = measured([4], [1, 0.4, 4], np.linspace(0.5, 3, 50))
    two = measured([5], [1, 0.6, 5], np.linspace(2.5, 9, 50))
    found = band_distance(one, two)
    assert found.band_rad_s == (2.5, 3.0)
    assert 2.5 <= found.omega_rad_s <= 3.0
    assert band_distance(one, two, (2.7, 20.0)).band_rad_s == (2.7, 3.0)


def test_between_its_points_a_response_is_linear_and_its_variance_that_of_the_mean() -> None:
    response = MeasuredResponse(np.array([1.0, 3.0]), np.array([2.0, 4j]), np.array([0.4, 0.8]))
    z, variance = response.at(np.array([1.0, 2.0, 3.0]))
    np.testing.assert_allclose(z, [2, 1 + 2j, 4j])
    np.testing.assert_allclose(variance, [0.4, 0.3, 0.8])


def test_the_standard_deviation_is_that_of_repeated_measurements() -> None:
    rng = np.random.default_rng(51)
    omega, variance = np.array([2.0, 2.4]), np.array([1e-4, 0.0])
    different, equal = measured([4], [1, 0.4, 4], omega), measured([5], [1, 0.6, 5], omega)
    z = np.array([different.z[0], equal.z[1]])  # so that the first point is always the worst
    found = band_distance(MeasuredResponse(omega, z, variance), SECOND)
    distances = []
    for _ in range(2000):
        noise = np.sqrt(variance / 2) * (rng.standard_normal(2) + 1j * rng.standard_normal(2))
        distances.append(band_distance(MeasuredResponse(omega, z + noise), SECOND).value)
    assert found.omega_rad_s == 2.0
    assert found.standard_deviation == pytest.approx(np.std(distances), rel=0.06)


def test_a_model_with_a_pole_in_the_band_is_infinitely_large_there() -> None:
    integrator = transfer_function([1], [1, 0])
    response = MeasuredResponse(np.array([0.0, 1.0]), np.array([0.0, 1.0 + 0j]))
    found = band_distance(integrator, response)
    assert (found.value, found.omega_rad_s) == (1.0, 0.0)


@pytest.mark.parametrize(
    ("band", "message"),
    [
        (
            None,
            r"known from 1 to 2 rad/s and from 3 to 4 rad/s; these do not overlap: measure both",
        ),
        ((5.0, 6.0), r"and the band 5 to 6; these do not overlap"),
        ((2.0, 1.0), "a band needs"),
        ((math.nan, 1.0), "a band needs"),
    ],
)
def test_a_band_with_nothing_in_it_is_refused(
    band: tuple[float, float] | None, message: str
) -> None:
    one = measured([4], [1, 0.4, 4], np.array([1.0, 2.0]))
    two = measured([4], [1, 0.4, 4], np.array([3.0, 4.0]))
    with pytest.raises(BandError, match=message):
        band_distance(one, two, band)


def test_above_the_nyquist_frequency_a_sampled_model_says_nothing() -> None:
    sampled = transfer_function([1], [1, 0.5], 1.0)
    beyond = measured([4], [1, 0.4, 4], np.array([4.0, 5.0]))
    with pytest.raises(BandError, match=r"from 0 to 3\.14159 rad/s"):
        band_distance(sampled, beyond)


def test_a_model_with_several_outputs_is_refused() -> None:
    wide = transfer_matrix([[[1]], [[1]]], [[[1, 1]], [[1, 2]]])
    with pytest.raises(ModelError, match="the model has 1 and 2"):
        band_distance(wide, measured([1], [1, 1], np.array([1.0, 2.0])))


def test_repeated_tests_are_averaged_by_their_variance_and_failed_ones_left_out() -> None:
    failed = Quality(reasons=(Finding(code="clipped", text="the output was clipped"),))

    def found(omega: float, z: complex, variance: float, quality: Quality) -> FrequencyResponse:
        return FrequencyResponse(np.array([omega]), np.array([z]), np.array([variance]), 4, quality)

    response = combined(
        [
            found(3.0, 1j, 0.1, Quality()),
            found(1.0, 2.0, 1.0, Quality()),
            found(1.0, 5.0, 0.5, Quality()),
            found(2.0, math.nan, math.inf, failed),
            found(1.0, 99.0, 0.1, failed),
        ]
    )
    np.testing.assert_allclose(response.omega_rad_s, [1, 3])
    np.testing.assert_allclose(response.z, [4, 1j])
    assert response.variance is not None
    np.testing.assert_allclose(response.variance, [1 / 3, 0.1])
    with pytest.raises(InvalidInputError, match="none of the tests is usable"):
        combined([found(2.0, math.nan, math.inf, failed)])


def test_tests_without_noise_are_averaged_too() -> None:
    exact = FrequencyResponse(np.array([1.0, 2.0]), np.array([1.0, 2j]), np.zeros(2), 4, Quality())
    np.testing.assert_allclose(combined([exact, exact]).z, [1, 2j])
