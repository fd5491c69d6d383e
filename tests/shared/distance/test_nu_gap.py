"""The ν-gap against published values, closed forms, exact arithmetic and independent formulas."""

from __future__ import annotations

import math

import nugap
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from random_models import exact_excess, perturbed, random_quotient, random_state_space
from scipy.linalg import solve_continuous_are, sqrtm

from nufleet.shared.distance.nu_gap import ACCURACY, NuGap, chordal_peak_in_band, nu_gap
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.models.realization import transfer_function, transfer_matrix
from nufleet.shared.models.transfer_models import ModelError, StateSpace

seeds = st.integers(0, 2**32 - 1)
LAG = np.polymul([0.025, 1], [0.025, 1])


def gap_of(num1: object, den1: object, num2: object, den2: object, dt_s: float = 0.0) -> NuGap:
    coefficients = [np.atleast_1d(np.asarray(p, dtype=float)) for p in (num1, den1, num2, den2)]
    return nu_gap(
        transfer_function(coefficients[0], coefficients[1], dt_s),
        transfer_function(coefficients[2], coefficients[3], dt_s),
    )


@pytest.mark.parametrize(
    ("models", "published"),
    [
        (([1], [1, -0.001], [1], [1, 0.001]), 0.0020),
        (([50], [1, 50], [400], np.polymul([1, 50], [1, 8])), 0.6147),
        (([100], [1, 1], [100], np.polymul([1, 1], LAG)), 0.8884),
        (([100], [1, 1], [100], [1, -1]), 0.0200),
    ],
)
def test_published_values_are_reproduced(models: tuple[object, ...], published: float) -> None:
    num1, den1, num2, den2 = models
    found = gap_of(num1, den1, num2, den2)
    assert found.value == pytest.approx(published, abs=5e-5)
    assert found.winding_ok


@pytest.mark.parametrize(
    ("models", "value", "omega"),
    [
        # Poles on the axis, also the same ones: k₁/sᵐ against k₂/sᵐ is |k₁ − k₂|/(k₁ + k₂).
        (([1], [1, 0], [2], [1, 0]), 1 / 3, math.sqrt(2)),
        (([1], [1, 0, 0], [1.5], [1, 0, 0]), 0.2, 1.5**0.25),
        (([1], [1, 0, 0, 0], [1.5], [1, 0, 0, 0]), 0.2, 1.5 ** (1 / 6)),
        (([1], [1, 0], [1], [1, 0, 0]), math.sqrt(0.5), 1.0),
        # Constants, reached everywhere; 0 and 1/(s + a) at 0; a difference only at infinity.
        (([1], [1], [3], [1]), 1 / math.sqrt(5), 0.0),
        (([0], [1], [3], [1, 1]), 3 / math.sqrt(10), 0.0),
        (([1], [1, 1], [1, 1], [1, 1]), math.sqrt(0.5), math.inf),
    ],
)
def test_closed_forms_are_met(models: tuple[object, ...], value: float, omega: float) -> None:
    num1, den1, num2, den2 = models
    found = gap_of(num1, den1, num2, den2)
    assert found.value == pytest.approx(value, abs=ACCURACY)
    assert found.omega_peak_rad_s == pytest.approx(omega, rel=1e-4)
    assert found.winding_ok


@pytest.mark.parametrize(
    ("num", "den"),
    [([1], [1, 0]), ([1], [1, 0, 4]), ([3, 1], np.poly([1, -1, -4])), ([1, 2], [1, 1])],
)
def test_a_model_has_no_distance_from_itself(num: list[float], den: np.ndarray) -> None:
    assert gap_of(num, den, num, den).value < ACCURACY


def test_opposite_models_are_as_far_as_can_be_where_their_graphs_are_orthogonal() -> None:
    found = gap_of([1], [1, 0], [-1], [1, 0])
    assert (found.value, found.winding_ok, found.winding_number) == (1.0, False, None)
    assert found.omega_peak_rad_s == pytest.approx(1.0, abs=1e-4)
    assert "det(I + P2*P1) = 0" in found.reason


def test_a_pole_that_crosses_the_axis_far_from_the_crossover_fails_the_winding_condition() -> None:
    found = gap_of([1], [1, 10], [1], [1, -10])
    assert found.value == 1.0
    assert found.chordal_peak == pytest.approx(0.2 / 1.01)
    assert (found.poles_unstable, found.poles_on_axis) == ((0, 1), (0, 0))
    assert found.winding_number == 0
    assert "the winding condition fails: wno 0 + η(P1) 0 − η(P2) 1 − η0(P2) 0 = -1" in found.reason
    assert "none" in found.guarantee


def test_the_winding_number_is_that_of_the_contour() -> None:
    rng = np.random.default_rng(11)
    omega = np.concatenate([-np.geomspace(1e5, 1e-5, 20_000), np.geomspace(1e-5, 1e5, 20_000)])
    numbers = set()
    for _ in range(40):
        first, second = random_quotient(rng), random_quotient(rng)
        p1, p2 = (np.polyval(n, 1j * omega) / np.polyval(d, 1j * omega) for n, d in (first, second))
        angle = np.unwrap(np.angle(1 + np.conj(p2) * p1))
        clockwise = -(angle[-1] - angle[0]) / (2 * np.pi)
        found = gap_of(*first, *second)
        assert found.winding_number == round(clockwise)
        numbers.add(found.winding_number)
    assert len(numbers) >= 4


@pytest.mark.thorough
@pytest.mark.parametrize("dt_s", [0.0, 0.05])
def test_five_hundred_pairs_agree_with_nugap(dt_s: float) -> None:
    """Where nugap resolves the response: well damped, no pole on the axis, ω = 0 included."""
    rng = np.random.default_rng(12)
    failures, successes, false_alarms = 0, 0, 0
    while failures + successes < 250:
        first = random_quotient(rng, dt_s, damping_min=0.3)
        second = (
            perturbed(rng, first, 0.1)
            if rng.random() < 0.6 and not dt_s
            else random_quotient(rng, dt_s, damping_min=0.3)
        )
        if any(len(num) == len(den) for num, den in (first, second)):
            continue  # nugap's grid ends where such a model may not have settled
        oracle, details = nugap.nu_gap(
            *(nugap.tf(num, den, dt_s or None) for num, den in (first, second)),
            n=8193,  # odd, so that the discrete-time grid holds z = 1
            return_details=True,
        )
        found = gap_of(*first, *second, dt_s)
        if details["touches_origin"]:  # a false alarm of high gains: exact arithmetic decides
            assert found.winding_ok == (exact_excess(first, second, dt_s) == 0)
            false_alarms += found.winding_ok
        else:
            assert found.value == pytest.approx(oracle, abs=1e-4), (first, second)
        assert found.chordal_peak == pytest.approx(details["sup_chordal"], abs=1e-4)
        failures += not found.winding_ok
        successes += found.winding_ok
    assert false_alarms < 10
    assert failures > 40
    assert successes > 40


@pytest.mark.parametrize("dt_s", [0.0, 0.02])
def test_the_winding_condition_is_decided_as_in_exact_arithmetic(dt_s: float) -> None:
    """Lightly damped, wide-spread, partly unstable, sampled fast: where grids fail."""
    rng = np.random.default_rng(13)
    excesses = set()
    for index in range(60):
        first = random_quotient(rng, dt_s, damping_min=0.003, omega_rad_s=(0.1, 100.0))
        second = random_quotient(rng, dt_s, damping_min=0.003, omega_rad_s=(0.1, 100.0))
        if index % 2 and not dt_s:
            second = perturbed(rng, first, 0.05)
        found = gap_of(*first, *second, dt_s)
        excess = exact_excess(first, second, dt_s)
        excesses.add(excess)
        assert found.winding_ok == (excess == 0)
        assert f"= {excess}" in found.reason
    assert len(excesses) >= 4


def test_nugap_is_wrong_about_poles_on_the_axis_and_about_high_gains() -> None:
    """It does not indent its contour, and takes a large |P| at a resonance for det = 0."""
    integrators = ([1.0], [1.0, 0.0]), ([2.0], [1.0, 0.0])
    resonances = ([1e4], [1.0, 0.02, 1.0]), ([1.1e4], [1.0, 0.02, 1.0])
    for (num1, den1), (num2, den2) in (integrators, resonances):
        assert nugap.nu_gap(nugap.tf(num1, den1), nugap.tf(num2, den2)) == 1.0
        assert gap_of(num1, den1, num2, den2).value < 0.4


def test_a_resonance_between_the_points_of_a_grid_is_found() -> None:
    models = [1e-4], [1, 2e-5, 1], [1e-4], [1, 2.2e-5, 1]
    found = gap_of(*models)
    omega = 1 + np.linspace(-1e-4, 1e-4, 200_001)
    p1, p2 = (1e-4 / (1 - omega**2 + 1j * c * omega) for c in (2e-5, 2.2e-5))
    psi = np.abs(p1 - p2) / np.sqrt((1 + np.abs(p1) ** 2) * (1 + np.abs(p2) ** 2))
    assert found.value == pytest.approx(psi.max(), abs=1e-7)
    assert found.omega_peak_rad_s == pytest.approx(omega[psi.argmax()], abs=1e-8)


@pytest.mark.parametrize("pole", [1.0, -1.0])
def test_poles_on_the_unit_circle_are_fine_even_where_the_bilinear_map_is_not(pole: float) -> None:
    found = gap_of([1], [1, -pole], [2], [1, -pole], 0.1)
    assert found.value == pytest.approx(1 / 3, abs=ACCURACY)
    assert (found.poles_on_axis, found.winding_ok) == ((1, 1), True)


def test_a_delay_more_is_the_opposite_at_the_nyquist_frequency() -> None:
    found = gap_of([1], [1, 0, 0], [1], [1, 0], 0.1)
    assert found.value == 1.0
    assert found.omega_peak_rad_s == pytest.approx(math.pi / 0.1)


def graph_symbol(model: StateSpace) -> tuple[np.ndarray, ...]:
    """Return the normalised right coprime factors [M; N] (Zhou, Doyle, Glover, theorem 13.37)."""
    a, b, c, d = model.a, model.b, model.c, model.d
    s, r = np.eye(model.inputs) + d.T @ d, np.eye(model.outputs) + d @ d.T
    x = solve_continuous_are(a - b @ np.linalg.solve(s, d.T @ c), b, c.T @ np.linalg.solve(r, c), s)
    f = -np.linalg.solve(s, d.T @ c + b.T @ x)
    root = np.linalg.inv(sqrtm(s).real)
    return a + b @ f, b @ root, np.vstack([f, c + d @ f]), np.vstack([root, d @ root])


def along_axis(symbol: tuple[np.ndarray, ...], omega: np.ndarray) -> np.ndarray:
    a, b, c, d = symbol
    resolvent = 1j * omega[:, None, None] * np.eye(len(a)) - a
    return np.asarray(
        c @ np.linalg.solve(resolvent, np.broadcast_to(b, (len(omega), *b.shape))) + d
    )


def test_many_inputs_and_outputs_agree_with_normalised_coprime_factors() -> None:
    """δ_ν = ‖(I − G₂G₂*)G₁‖∞ iff wno det(G₂*G₁) = 0: a Riccati equation each and a dense grid."""
    rng = np.random.default_rng(14)
    omega = np.concatenate([-np.geomspace(1e4, 1e-3, 2000), [0], np.geomspace(1e-3, 1e4, 2000)])
    outcomes = []
    for index in range(18):
        states, inputs, outputs = (int(rng.integers(1, high)) for high in (6, 4, 4))
        first = random_state_space(rng, states, inputs, outputs)
        second = (
            random_state_space(rng, states, inputs, outputs)
            if index % 3 == 0
            else StateSpace(
                first.a + 0.2 * rng.standard_normal(first.a.shape), first.b, first.c, first.d
            )
        )
        g1, g2 = (along_axis(graph_symbol(model), omega) for model in (first, second))
        inner = np.swapaxes(g2.conj(), 1, 2) @ g1
        sup = np.linalg.norm(g1 - g2 @ inner, 2, axis=(1, 2)).max()
        angle = np.unwrap(np.angle(np.linalg.det(inner)))
        winds = abs(angle[-1] - angle[0]) > np.pi
        found = nu_gap(first, second)
        assert found.chordal_peak == pytest.approx(sup, abs=1e-4)  # the grid's error
        assert found.chordal_peak >= sup - 1e-8
        assert found.winding_ok == (not winds)
        outcomes.append(found.winding_ok)
    assert 3 <= sum(outcomes) <= 15


def test_models_in_parallel_are_as_far_apart_as_the_farthest_pair() -> None:
    one, two, three = ([1.0], [1.0, 1.0]), ([2.0], [1.0, 1.0]), ([1.0], [1.0, 0.0])
    zero = ([0.0], [1.0])
    first, second = (
        transfer_matrix(
            [[p[0], zero[0]], [zero[0], three[0]]], [[p[1], zero[1]], [zero[1], three[1]]]
        )
        for p in (one, two)
    )
    assert nu_gap(first, second).value == pytest.approx(gap_of(*one, *two).value, abs=ACCURACY)


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_it_is_a_metric(seed: int) -> None:
    rng = np.random.default_rng(seed)
    states, inputs, outputs = (int(rng.integers(1, high)) for high in (5, 3, 3))
    p1 = random_state_space(rng, states, inputs, outputs)
    p2, p3 = (
        StateSpace(p1.a + size * rng.standard_normal(p1.a.shape), p1.b, p1.c, p1.d)
        for size in rng.uniform(0.01, 0.5, 2)
    )
    d12, d21, d13, d23 = (nu_gap(*pair).value for pair in ((p1, p2), (p2, p1), (p1, p3), (p2, p3)))
    assert d12 == pytest.approx(d21, abs=1e-7)
    assert 0 <= d13 <= 1
    assert d13 <= d12 + d23 + 1e-7


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_it_does_not_depend_on_coordinates_transposition_or_the_time_scale(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = random_state_space(rng, 3, 2, 1)
    second = StateSpace(first.a + 0.1 * rng.standard_normal((3, 3)), first.b, first.c, first.d)
    expected = nu_gap(first, second)
    basis = rng.standard_normal((3, 3)) + 3 * np.eye(3)
    inverse = np.linalg.inv(basis)

    def moved(p: StateSpace) -> StateSpace:
        return StateSpace(basis @ p.a @ inverse, basis @ p.b, p.c @ inverse, p.d)

    def turned(p: StateSpace) -> StateSpace:
        return StateSpace(p.a.T, p.c.T, p.b.T, p.d.T)

    def faster(p: StateSpace) -> StateSpace:
        return StateSpace(1e3 * p.a, 1e3 * p.b, p.c, p.d)

    for change in (moved, turned, faster):
        found = nu_gap(change(first), change(second))
        assert found.value == pytest.approx(expected.value, abs=1e-7)
        assert found.winding_ok == expected.winding_ok


@settings(max_examples=25, deadline=None)
@given(seeds)
def test_discrete_time_is_continuous_time_by_the_bilinear_map(seed: int) -> None:
    rng = np.random.default_rng(seed)
    first = random_state_space(rng, 3, 1, 2)
    second = StateSpace(first.a + 0.1 * rng.standard_normal((3, 3)), first.b, first.c, first.d)
    if any(np.abs(p.modes - 2 / 0.1).min() < 1e-2 for p in (first, second)):
        return

    def sampled(p: StateSpace, dt_s: float = 0.1) -> StateSpace:
        inverse = np.linalg.inv(2 / dt_s * np.eye(3) - p.a)
        return StateSpace(
            inverse @ (2 / dt_s * np.eye(3) + p.a),
            inverse @ p.b * 2 / math.sqrt(dt_s),
            p.c @ inverse * 2 / math.sqrt(dt_s),
            p.d + p.c @ inverse @ p.b,
            dt_s,
        )

    continuous, discrete = nu_gap(first, second), nu_gap(sampled(first), sampled(second))
    assert discrete.value == pytest.approx(continuous.value, abs=1e-7)
    assert (discrete.winding_number, discrete.poles_unstable) == (
        continuous.winding_number,
        continuous.poles_unstable,
    )


def test_the_band_limited_peak_is_the_peak_of_a_dense_grid_in_the_band() -> None:
    first, second = transfer_function([1], [1, 0.1, 1]), transfer_function([1], [1, 0.12, 1.1])
    for band in ((0.1, 0.8), (0.9, 1.2), (2.0, 9.0), (0.0, 100.0)):
        omega = np.linspace(*band, 100_001)
        p1, p2 = (
            np.polyval([1], 1j * omega) / np.polyval(d, 1j * omega)
            for d in ([1, 0.1, 1], [1, 0.12, 1.1])
        )
        psi = np.abs(p1 - p2) / np.sqrt((1 + np.abs(p1) ** 2) * (1 + np.abs(p2) ** 2))
        peak = chordal_peak_in_band(first, second, band)
        assert peak.value == pytest.approx(psi.max(), abs=1e-6)
        assert band[0] <= peak.omega_rad_s <= band[1]


@pytest.mark.parametrize(
    "band", [(2.0, 1.0), (1.0, 1.0), (-1.0, 2.0), (math.nan, 1.0), (1.0, math.inf)]
)
def test_a_band_that_is_none_is_refused(band: tuple[float, float]) -> None:
    model = transfer_function([1], [1, 1])
    with pytest.raises(InvalidInputError, match="a band needs"):
        chordal_peak_in_band(model, model, band)


def test_a_band_beyond_the_nyquist_frequency_is_refused() -> None:
    model = transfer_function([1], [1, 0.5], 0.1)
    with pytest.raises(InvalidInputError, match=r"above the Nyquist frequency 31\.4159"):
        chordal_peak_in_band(model, model, (1.0, 32.0))


def test_a_model_that_no_controller_stabilises_is_refused() -> None:
    with pytest.raises(ModelError, match=r"second model has a hidden unstable mode at 1\+0j"):
        gap_of([1], [1, 1], [1, -1], np.poly([1, -2]))


def test_the_guarantee_is_rounded_up() -> None:
    found = gap_of([1], [1, 0], [2], [1, 0])
    assert "margin above 0.3334 also stabilises" in found.guarantee
