"""Transfer functions become state-space models with the same response and few states."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_quotient

from nufleet.shared.models.realization import minimal, transfer_function, transfer_matrix
from nufleet.shared.models.transfer_models import ModelError, StateSpace


def response(model: StateSpace, omega: float) -> np.ndarray:
    graph = model.graph(np.array([omega]))[0]
    return np.asarray(graph[model.inputs :] @ np.linalg.inv(graph[: model.inputs]))


@pytest.mark.parametrize("dt_s", [0.0, 0.05])
def test_a_realisation_has_the_response_of_the_fraction(dt_s: float) -> None:
    rng = np.random.default_rng(2)
    for _ in range(30):
        num, den = random_quotient(rng, dt_s)
        model = transfer_function(num, den, dt_s)
        assert model.states == len(den) - 1
        for omega in (0.4, 5.0, 40.0):
            point = np.exp(1j * omega * dt_s) if dt_s else 1j * omega
            expected = np.polyval(num, point) / np.polyval(den, point)
            assert response(model, omega)[0, 0] == pytest.approx(expected, rel=1e-7)


def test_a_model_sampled_fast_keeps_its_poles() -> None:
    poles = np.exp(0.002 * np.array([-0.5, -0.6, -1 + 1j, -1 - 1j]))
    den = np.poly(poles).real
    modes = transfer_function([1], den, 0.002).modes
    np.testing.assert_allclose(
        np.sort_complex(np.poly(modes - 1)),
        np.sort_complex(np.poly(poles - 1)),
        rtol=1e-6,
        atol=1e-14,
    )


def test_states_are_scaled_until_the_rows_and_columns_of_a_are_alike() -> None:
    rng = np.random.default_rng(4)
    for order in (2, 5, 9):
        den = 10 ** rng.uniform(-9, 9, order + 1)
        a = transfer_function([1], den).a
        rows, columns = np.linalg.norm(a, axis=1), np.linalg.norm(a, axis=0)
        np.testing.assert_array_less(np.abs(np.log2(rows / columns)), 2.0)


def test_a_constant_and_leading_zeros_are_fine() -> None:
    model = transfer_function([0, 0, 3], [0, 2])
    assert model.states == 0
    assert response(model, 1.0)[0, 0] == 1.5


@pytest.mark.parametrize(
    ("num", "den", "message"),
    [
        ([1, 0, 0], [1, 1], "improper transfer function: the numerator has degree 2"),
        ([1], [0, 0], "denominator of a transfer function is zero"),
        ([1, float("nan")], [1, 1], "must be finite"),
        ([1], [5e-324, 1, 1], "first coefficient of the denominator, 4.94066e-324, is too small"),
        ([1, 1e10], [1e-300, 1], "too small beside the other"),
    ],
)
def test_a_fraction_that_is_no_model_is_refused(
    num: list[float], den: list[float], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        transfer_function(num, den)


def test_a_matrix_of_fractions_has_each_response_in_its_place() -> None:
    num = [[[1], [2, 1]], [[3], [0]], [[1], [1]]]
    den = [[[1, 1], [1, 2]], [[1, 0, 1], [1]], [[1, 1], [1, 3]]]
    model = transfer_matrix(num, den)
    for i, row in enumerate(num):
        for j, numerator in enumerate(row):
            expected = np.polyval(numerator, 0.7j) / np.polyval(den[i][j], 0.7j)
            assert response(model, 0.7)[i, j] == pytest.approx(expected, rel=1e-10, abs=1e-12)


def test_a_matrix_of_rank_one_has_one_state_per_pole() -> None:
    integrator = [[[1.0, 0.0]] * 3] * 2
    model = transfer_matrix([[[1.0], [2.0], [3.0]], [[2.0], [4.0], [6.0]]], integrator)
    assert model.states == 1
    assert model.hidden_unstable_mode() is None


def test_two_inputs_with_independent_integrators_need_two_states() -> None:
    assert transfer_matrix([[[1], [0]], [[0], [1]]], [[[1, 0], [1]], [[1], [1, 0]]]).states == 2


def test_ragged_matrices_of_fractions_are_refused() -> None:
    with pytest.raises(ModelError, match="full matrices"):
        transfer_matrix([[[1], [2]], [[1]]], [[[1], [1]], [[1], [1]]])
    with pytest.raises(ModelError, match="full matrices"):
        transfer_matrix([[[1]]], [[[1], [1]]])


def test_reduction_keeps_the_response_and_drops_what_cannot_be_seen() -> None:
    rng = np.random.default_rng(3)
    basis = rng.standard_normal((4, 4))
    seen = np.diag([-1.0, 2.0])
    a = np.block([[seen, np.zeros((2, 2))], [rng.standard_normal((2, 2)), np.diag([-3.0, 4.0])]])
    b = np.vstack([np.ones((2, 1)), np.zeros((2, 1))])
    c = np.hstack([np.ones((1, 2)), np.zeros((1, 2))])
    inverse = np.linalg.inv(basis)
    model = StateSpace(basis @ a @ inverse, basis @ b, c @ inverse, np.zeros((1, 1)))
    reduced = minimal(model)
    np.testing.assert_allclose(np.sort(reduced.modes.real), [-1, 2], atol=1e-9)
    assert response(reduced, 0.3)[0, 0] == pytest.approx(1 / (0.3j + 1) + 1 / (0.3j - 2), rel=1e-9)
