"""The compiled pieces of the Gaussian process: exponential, Hessian, quadratic in a box."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process import core
from nufleet.shared.gaussian_process.problem import FitStatus


@given(st.floats(-708.0, 709.0))
def test_the_exponential_is_right_to_two_units_in_the_last_place(x: float) -> None:
    assert core._exp(x) == pytest.approx(np.exp(x), rel=2 * np.finfo(float).eps, abs=0.0)


def gradient_and_hessian(
    x: FloatArray, y: FloatArray, known: FloatArray, theta: FloatArray
) -> tuple[FloatArray, FloatArray]:
    work = core._allocate(len(y))
    core._measure(work, x)
    assert np.isfinite(core._likelihood(work, y, known, theta, 0.0))
    gradient, hessian = np.empty(3), np.empty((3, 3))
    core._derivatives(work, y, theta, gradient, hessian)
    return gradient, hessian


@given(
    st.integers(1, 21),
    st.integers(1, 3),
    st.integers(0, 2**32 - 1),
    st.tuples(st.floats(-3, 2), st.floats(-2, 2), st.floats(-5, 0)),
)
@settings(deadline=None)
def test_the_hessian_is_the_slope_of_the_gradient(
    n: int, d: int, seed: int, point: tuple[float, float, float]
) -> None:
    rng = np.random.default_rng(seed)
    x, y, known = rng.uniform(-1, 1, (n, d)), rng.standard_normal(n), rng.uniform(0, 0.2, n)
    theta = np.array(point)
    _, hessian = gradient_and_hessian(x, y, known, theta)
    for i in range(3):
        step = 1e-5 * np.eye(3)[i]
        above, _ = gradient_and_hessian(x, y, known, theta + step)
        below, _ = gradient_and_hessian(x, y, known, theta - step)
        np.testing.assert_allclose(
            hessian[i],
            (above - below) / 2e-5,
            rtol=1e-5,
            atol=1e-6 * np.max(np.abs(hessian)) + 1e-6,
        )


def test_what_one_problem_leaves_behind_does_not_reach_the_next() -> None:
    rng = np.random.default_rng(0)
    work = core._allocate(21)
    for n in (21, 4, 13, 1, 20):
        x, y, known = rng.uniform(-1, 1, (n, 2)), rng.standard_normal(n), np.full(n, 0.1)
        theta = np.array([0.1, -0.3, -2.0])
        expected_gradient, expected_hessian = gradient_and_hessian(x, y, known, theta)
        core._measure(work, x)
        core._likelihood(work, y, known, theta, 0.0)
        gradient, hessian = np.empty(3), np.empty((3, 3))
        core._derivatives(work, y, theta, gradient, hessian)
        np.testing.assert_array_equal(gradient, expected_gradient)
        np.testing.assert_array_equal(hessian, expected_hessian)


numbers = st.floats(-10, 10, allow_subnormal=False)
widths = st.sampled_from([0.0, 0.5, 3.0])


@given(
    st.lists(numbers, min_size=3, max_size=3),
    st.lists(numbers, min_size=6, max_size=6),
    st.lists(widths, min_size=6, max_size=6),
)
@settings(deadline=None, max_examples=200)
def test_the_model_minimum_is_global_in_its_box(
    slope: list[float], entries: list[float], sides: list[float]
) -> None:
    gradient, hessian = np.array(slope), np.zeros((3, 3))
    hessian[np.triu_indices(3)] = entries
    hessian = hessian + np.triu(hessian, 1).T
    low, high = -np.array(sides[:3]), np.array(sides[3:])
    step = np.full(3, np.nan)
    best = core._box_minimum(gradient, hessian, low, high, step)

    def model(p: FloatArray) -> float:
        return float(gradient @ p + 0.5 * p @ hessian @ p)

    assert np.all((low <= step) & (step <= high))
    assert best == pytest.approx(model(step), abs=1e-9)
    axes = [np.linspace(a, b, 9) for a, b in zip(low, high, strict=True)]
    assert best <= min(model(np.array(p)) for p in itertools.product(*axes)) + 1e-9


def test_newton_converges_in_a_few_evaluations_from_near_the_optimum() -> None:
    rng = np.random.default_rng(1)
    x = rng.uniform(0, 2, (50, 4))
    y = np.sin(2 * x.sum(axis=1)) + 0.1 * rng.standard_normal(50)
    work, known = core._allocate(50), np.zeros(50)
    core._measure(work, x)
    bounds = np.log([[1e-4, 1e-2, 1e-6], [1e3, 1e3, 1e2]])
    theta = np.log([0.1, 0.5, 0.002])
    assert core._minimise(work, y, known, theta, bounds, 1e-9, 200)[4] == FitStatus.CONVERGED
    nearby = theta + 0.05
    outcome = core._minimise(work, y, known, nearby, bounds, 1e-7, 200)
    assert outcome[4] == FitStatus.CONVERGED
    assert outcome[3] <= 5
    np.testing.assert_allclose(nearby, theta, atol=1e-6)
