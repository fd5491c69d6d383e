"""The ν-gap of polynomials and the one of matrices are two computations of the same number."""

from __future__ import annotations

import math

import numpy as np
import pytest
from random_models import exact_excess, perturbed, random_quotient

from nufleet.shared.distance.nu_gap import ACCURACY, nu_gap
from nufleet.shared.distance.rational_gap import RationalGap, compiled, rational_nu_gap
from nufleet.shared.models.realization import transfer_function
from nufleet.shared.models.transfer_models import ModelError


@pytest.mark.thorough
@pytest.mark.parametrize("dt_s", [0.0, 0.02])
def test_it_agrees_with_the_matrices_on_hard_pairs(dt_s: float) -> None:
    assert_agreement(rational_nu_gap, dt_s)


@pytest.mark.thorough
def test_it_agrees_with_the_matrices_when_it_is_compiled() -> None:
    gap = compiled()
    for dt_s in (0.0, 0.02):
        assert_agreement(gap, dt_s)


def assert_agreement(gap: RationalGap, dt_s: float) -> None:
    """Compare with the matrices, and count the zeros exactly."""
    rng = np.random.default_rng(21)
    for index in range(150):
        first = random_quotient(rng, dt_s, damping_min=0.003, omega_rad_s=(0.1, 100.0))
        second = random_quotient(rng, dt_s, damping_min=0.003, omega_rad_s=(0.1, 100.0))
        if index % 2:
            # Sampled fast, a small change of a coefficient makes another model altogether.
            near = 1e-3 if len(first[1]) == 2 else 0.0 if dt_s else 0.05
            gain = rng.uniform(0.8, 1.2)
            second = perturbed(rng, first, near)
            second = np.polyadd(gain * second[0], [0.01 * first[0][0], 0.02]), second[1]
        found = gap(*first, *second, dt_s)
        expected = nu_gap(transfer_function(*first, dt_s), transfer_function(*second, dt_s))
        assert found.chordal_peak == pytest.approx(expected.chordal_peak, abs=1e-7)
        assert found.winding_ok == expected.winding_ok
        if found.chordal_peak < 1 - ACCURACY:
            assert found.winding_ok == (exact_excess(first, second, dt_s) == 0)
        assert found.winding_number == expected.winding_number
        assert found.poles_unstable == expected.poles_unstable
        assert found.reason[:25] == expected.reason[:25]
        assert (found.computed_from, expected.computed_from) == ("polynomials", "matrices")


@pytest.mark.parametrize(
    ("models", "value", "on_axis"),
    [
        (([1], [1, 0], [2], [1, 0], 0.0), 1 / 3, (1, 1)),
        (([1], [1, 0, 0, 0], [1.5], [1, 0, 0, 0], 0.0), 0.2, (3, 3)),
        (([1], [1, 0], [1], [1, 0, 0], 0.0), math.sqrt(0.5), (1, 2)),
        (([0, 0, 1], [1], [3], [1], 0.0), 1 / math.sqrt(5), (0, 0)),
        (([1], [1, 1], [2], [1, 1], 0.1), 1 / 3, (1, 1)),
        (([1], [1, 0, -1], [1.5], [1, 0, -1], 0.1), 0.2, (2, 2)),
        (([1], [1, 0, 0], [1], [1, 0], 0.1), 1.0, (0, 0)),
        (([1], [1, 10], [1], [1, -10], 0.0), 1.0, (0, 0)),
    ],
)
def test_closed_forms_are_met(
    models: tuple[list[float], list[float], list[float], list[float], float],
    value: float,
    on_axis: tuple[int, int],
) -> None:
    found = rational_nu_gap(*models)
    assert found.value == pytest.approx(value, abs=ACCURACY)
    assert found.poles_on_axis == on_axis


def test_the_peak_at_infinity_is_reported_there() -> None:
    assert rational_nu_gap([1], [1, 1], [1, 1], [1, 1]).omega_peak_rad_s == math.inf
    sampled = rational_nu_gap([1, 1], [1, 0], [1, 0.5], [1, 0], 0.1)
    assert sampled.omega_peak_rad_s == pytest.approx(math.pi / 0.1)


@pytest.mark.parametrize(
    ("num", "den", "message"),
    [
        ([1, 0, 0], [1, 1], "improper"),
        ([1], [0, 0], "denominator"),
        ([math.nan], [1, 1], "finite"),
        ([1, -1], [1, 0, -1], "hidden unstable mode"),
        ([1, 0], [1, 1, 0], "hidden unstable mode"),
        ([1, 0], [1, 0, 0], "hidden unstable mode"),
    ],
)
def test_what_the_matrices_refuse_is_refused(
    num: list[float], den: list[float], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        rational_nu_gap(num, den, [1], [1, 1])


def test_a_pole_at_minus_one_that_is_cancelled_is_refused() -> None:
    with pytest.raises(ModelError, match="hidden unstable mode"):
        rational_nu_gap([1, 1], [1, 1.5, 0.5], [1], [1, 0.5], 0.1)


def test_polynomials_that_underflow_are_left_to_the_matrices_which_refuse_them() -> None:
    with pytest.raises(ModelError, match="hidden unstable mode at -1e-170"):
        rational_nu_gap([1e-170], [1, 1e-170], [2e-170], [1, 1e-170])
