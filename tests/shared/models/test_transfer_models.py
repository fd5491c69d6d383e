"""What a linear model is, what it refuses to be, and its graph."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import random_state_space, state_space
from scipy import signal

from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.models.realization import transfer_function
from nufleet.shared.models.transfer_models import (
    ModelError,
    StateSpace,
    require_same_shape,
)

ONE = np.ones((1, 1))


def response(model: StateSpace, omega: float) -> np.ndarray:
    graph = model.graph(np.array([omega]))[0]
    return np.asarray(graph[model.inputs :] @ np.linalg.inv(graph[: model.inputs]))


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        ((np.ones((2, 3)), ONE, ONE, ONE), "A is 2 × 3, expected 2 × 2"),
        ((np.ones((2, 2)), ONE, np.ones((1, 2)), ONE), "B is 1 × 1, expected 2 × 1"),
        ((np.ones((2, 2)), np.ones((2, 1)), ONE, ONE), "C is 1 × 1, expected 1 × 2"),
        ((ONE, ONE, ONE, np.array([[np.nan]])), "D must be a matrix of finite numbers"),
        ((ONE, ONE, ONE, np.ones(1)), "D must be a matrix of finite numbers"),
        ((ONE, np.ones((1, 0)), ONE, np.ones((1, 0))), "at least one input"),
    ],
)
def test_matrices_that_do_not_fit_are_refused(
    matrices: tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray], message: str
) -> None:
    with pytest.raises(ModelError, match=message):
        StateSpace(*matrices)


@pytest.mark.parametrize("dt_s", [-0.1, float("nan"), float("inf")])
def test_a_sample_time_that_is_none_is_refused(dt_s: float) -> None:
    with pytest.raises(ModelError, match="dt must be"):
        StateSpace(ONE, ONE, ONE, ONE, dt_s)


@pytest.mark.parametrize("dt_s", [0.0, 0.1])
def test_the_graph_holds_the_frequency_response_that_scipy_computes(dt_s: float) -> None:
    rng = np.random.default_rng(1)
    model = random_state_space(rng, 4, 2, 3, shift=3.0)
    model = StateSpace(0.3 * model.a if dt_s else model.a, model.b, model.c, model.d, dt_s)
    for column in range(2):
        single = (model.a, model.b[:, [column]], model.c, model.d[:, [column]])
        for row in range(3):
            system = (single[0], single[1], single[2][[row]], single[3][[row]])
            omega = np.array([0.2, 3.0])
            if dt_s:
                _, expected = signal.dfreqresp((*system, dt_s), omega * dt_s)
            else:
                _, expected = signal.freqresp(system, omega)
            found = [response(model, w)[row, column] for w in omega]
            np.testing.assert_allclose(found, expected, rtol=1e-10)


def test_the_graph_at_infinity_holds_the_direct_term() -> None:
    model = transfer_function([3, 1], [1, 2])
    np.testing.assert_allclose(model.graph(np.array([1.0, np.inf]))[1], [[1], [3]])


def test_the_graph_at_a_pole_is_vertical() -> None:
    for model, omega in (
        (transfer_function([1], [1, 0]), 0.0),
        (transfer_function([1], [1, 0, 4]), 2.0),
        (transfer_function([1], [1, -1], 0.1), 0.0),
        (transfer_function([1], [1, 1], 0.1), np.pi / 0.1),
    ):
        control, output = model.graph(np.array([omega]))[0, :, 0]
        assert abs(control) < 1e-12 * abs(output)


def test_the_graph_near_a_pole_agrees_with_the_response() -> None:
    model = transfer_function([1], [1, 0])
    np.testing.assert_allclose(response(model, 1e-3), [[-1e3j]], rtol=1e-12)


def test_poles_are_counted_beyond_and_on_the_axis() -> None:
    continuous = transfer_function([1], np.poly([0, 2j, -2j, 1, -1]))
    assert (continuous.poles_unstable, continuous.poles_on_axis) == (1, 3)
    discrete = transfer_function([1], np.poly([1, -1, 0.6 + 0.8j, 0.6 - 0.8j, 1.2, 0.3]), 0.1)
    assert (discrete.poles_unstable, discrete.poles_on_axis) == (1, 4)


@pytest.mark.parametrize(
    ("num", "den", "dt_s"),
    [
        ([1, -1], np.poly([1, -2]), 0.0),
        ([1, 0], np.poly([0, -2]), 0.0),
        ([1, -1.5], np.poly([1.5, 0.2]), 0.1),
        ([0], [1, -1], 0.0),
    ],
)
def test_a_mode_that_is_cancelled_beyond_or_on_the_axis_is_hidden(
    num: list[float], den: np.ndarray, dt_s: float
) -> None:
    assert transfer_function(num, den, dt_s).hidden_unstable_mode() is not None


def test_a_stable_hidden_mode_does_not_matter() -> None:
    assert transfer_function([1, 1], np.poly([-1, 2])).hidden_unstable_mode() is None


def test_a_mode_no_input_reaches_is_hidden_whatever_the_units_of_the_input() -> None:
    a, c = np.diag([1.0, -1.0]), np.ones((1, 2))
    for unit in (1e-9, 1.0, 1e9):
        model = StateSpace(a, np.array([[0.0], [unit]]), c, np.zeros((1, 1)))
        assert model.hidden_unstable_mode() == pytest.approx(1.0)
        reached = StateSpace(a, np.array([[unit], [0.0]]), c, np.zeros((1, 1)))
        assert reached.hidden_unstable_mode() is None


def test_a_robots_model_becomes_a_state_space_model_with_the_same_response() -> None:
    model = LinearModel(
        a=((0.9, 0.1), (-0.2, 0.8)), b=(0.0, 0.1), c=(1.0, 0.0), d=0.2, sample_time_s=0.02
    )
    omega = np.array([0.5, 7.0])
    found = [response(state_space(model), w)[0, 0] for w in omega]
    np.testing.assert_allclose(found, model.frequency_response(omega), rtol=1e-12)


def test_models_of_different_signals_or_sample_times_cannot_be_compared() -> None:
    siso, sampled = transfer_function([1], [1, 1]), transfer_function([1], [1, 0.5], 0.1)
    wide = StateSpace(-ONE, np.ones((1, 2)), ONE, np.zeros((1, 2)))
    with pytest.raises(ModelError, match="differ in sample time"):
        require_same_shape(siso, sampled)
    with pytest.raises(ModelError, match="1 × 1 and 1 × 2"):
        require_same_shape(siso, wide)
