"""The online process learns what its prior leaves; nothing that a sensor says makes it raise."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from nufleet.robot_agent.flight.online_gp import BOUNDS, START, OnlineGp, Outcome
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.online import OnlineFit
from nufleet.shared.gaussian_process.problem import Bounds

LAYOUT = InverseLayout(
    architecture="state", states=("position", "velocity"), sample_time_s=0.02, horizon_samples=5
)
FIXED = Bounds((0.1, 0.1), (0.5, 0.5), (0.002, 0.002))


def half(inputs: FloatArray) -> FloatArray:
    return 0.5 * inputs[:, 0]


def truth(inputs: FloatArray) -> FloatArray:
    return half(inputs) + 0.3 * np.sin(2 * inputs[:, 1]) + 0.1


def pairs(count: int, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    rng = np.random.default_rng(seed)
    inputs = rng.uniform(-1, 1, (count, 4))
    return inputs, truth(inputs) + 0.02 * rng.standard_normal(count)


def test_without_pairs_it_is_the_prior() -> None:
    query = pairs(2)[0]
    found = OnlineGp(LAYOUT, (half, None)).correct(query)
    np.testing.assert_array_equal(found.gamma, [half(query)[0], 0.0])
    assert found.outcomes == (Outcome.PRIOR, Outcome.PRIOR)
    np.testing.assert_allclose(found.variance, 0.1)


def test_with_fixed_hyperparameters_it_is_the_posterior_of_the_papers_eq_2() -> None:
    process = OnlineGp(LAYOUT, (half,), bounds=FIXED)
    inputs, gamma = pairs(50)
    for row, value in zip(inputs, gamma, strict=True):
        process.learn(0, row, value)
    query = pairs(1, seed=1)[0]
    kernel = ConstantKernel(0.1) * Matern(0.5, nu=1.5) + WhiteKernel(0.002)
    oracle = GaussianProcessRegressor(kernel, optimizer=None).fit(inputs, gamma - half(inputs))
    mean, deviation = oracle.predict(query, return_std=True)
    found = process.correct(query)
    np.testing.assert_allclose(found.gamma, half(query) + mean, rtol=1e-9)
    np.testing.assert_allclose(found.variance, deviation**2 - 0.002, rtol=1e-6)


def test_it_learns_what_the_prior_leaves() -> None:
    process = OnlineGp(LAYOUT, (half,))
    for row, value in zip(*pairs(50), strict=True):
        process.learn(0, row, value)
    queries = 0.7 * pairs(40, seed=2)[0]
    left = [abs(process.correct(q[np.newaxis]).gamma[0] - truth(q[np.newaxis])[0]) for q in queries]
    before = np.abs(truth(queries) - half(queries))
    assert np.sqrt(np.mean(np.square(left))) < 0.35 * np.sqrt(np.mean(before**2))


def test_only_the_latest_fifty_pairs_count() -> None:
    long, short = OnlineGp(LAYOUT, (half,), bounds=FIXED), OnlineGp(LAYOUT, (half,), bounds=FIXED)
    inputs, gamma = pairs(120)
    for k, (row, value) in enumerate(zip(inputs, gamma, strict=True)):
        long.learn(0, row, value)
        if k >= 70:
            short.learn(0, row, value)
    query = pairs(1, seed=3)[0]
    np.testing.assert_array_equal(long.correct(query).gamma, short.correct(query).gamma)


def test_axes_do_not_learn_from_each_other() -> None:
    process = OnlineGp(LAYOUT, (half, half))
    for row, value in zip(*pairs(20), strict=True):
        process.learn(0, row, value)
    found = process.correct(pairs(2, seed=4)[0])
    assert found.outcomes == (Outcome.FITTED, Outcome.PRIOR)
    assert found.mean[1] == 0.0


def test_a_window_of_none_leaves_the_prior_alone() -> None:
    process = OnlineGp(LAYOUT, (half,), window=0)
    inputs, gamma = pairs(5)
    process.learn(0, inputs[0], gamma[0])
    found = process.correct(inputs[:1])
    assert (found.gamma[0], found.outcomes) == (half(inputs[:1])[0], (Outcome.PRIOR,))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_pair_that_is_not_finite_is_dropped_and_counted(bad: float) -> None:
    process = OnlineGp(LAYOUT, (half,))
    inputs, gamma = pairs(2)
    process.learn(0, inputs[0], gamma[0])
    expected = process.correct(inputs[1:]).gamma
    process.learn(0, inputs[1], bad)
    process.learn(0, inputs[1] * np.array([1.0, bad, 1.0, 1.0]), gamma[1])
    assert process.dropped == 2
    np.testing.assert_allclose(process.correct(inputs[1:]).gamma, expected, rtol=1e-6)


def test_inputs_or_a_prior_that_are_not_finite_give_gamma_zero() -> None:
    def broken(inputs: FloatArray) -> FloatArray:
        return np.full(len(inputs), np.nan)

    process = OnlineGp(LAYOUT, (half, broken))
    query = pairs(2)[0]
    query[0, 2] = np.nan
    found = process.correct(query)
    assert found.outcomes == (Outcome.NOT_FINITE, Outcome.NOT_FINITE)
    np.testing.assert_array_equal(found.gamma, [0.0, 0.0])


def test_a_window_of_one_repeated_point_gives_its_mean() -> None:
    process = OnlineGp(LAYOUT, (None,))
    row = np.full(4, 0.3)
    for value in np.tile([0.4, 0.6], 25):
        process.learn(0, row, value)
    found = process.correct(row[np.newaxis])
    assert found.outcomes == (Outcome.FITTED,)
    assert found.gamma[0] == pytest.approx(0.5, abs=0.05)


@settings(max_examples=60, deadline=None)
@given(st.integers(0, 10_000), st.sampled_from([1e-12, 1e-3, 1.0, 1e6, 1e150, 1e300]))
def test_no_window_makes_it_raise_or_answer_with_something_not_finite(
    seed: int, scale: float
) -> None:
    rng = np.random.default_rng(seed)
    process = OnlineGp(LAYOUT, (None,))
    for _ in range(12):
        row = scale * rng.integers(-2, 3, 4) * rng.uniform(0.5, 1, 4) ** rng.integers(0, 2)
        process.learn(0, row, float(scale * rng.standard_normal()))
    for query in (np.zeros((1, 4)), scale * rng.standard_normal((1, 4))):
        found = process.correct(query)
        assert np.isfinite(found.gamma).all()
        assert np.isfinite(found.variance).all()


def test_what_each_axis_was_fitted_with_can_be_read() -> None:
    process = OnlineGp(LAYOUT, (half, half))
    for row, value in zip(*pairs(30), strict=True):
        process.learn(0, row, value)
    process.correct(pairs(2)[0])
    fitted, at_start = (found.log(1) for found in process.hyperparameters)
    np.testing.assert_allclose(at_start, START.log(1))
    low, high = BOUNDS.log()
    assert ((low <= fitted + 1e-12) & (fitted - 1e-12 <= high)).all()
    assert np.abs(fitted - at_start).max() > 0.1
    assert OnlineGp(LAYOUT, (half,), window=0).hyperparameters == ()


def test_it_is_fitted_again_for_new_pairs_alone_which_changes_no_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    fitted: list[OnlineFit] = []
    refit = OnlineFit.refit

    def counted(self: OnlineFit, x: FloatArray, y: FloatArray) -> None:
        fitted.append(self)
        refit(self, x, y)

    monkeypatch.setattr(OnlineFit, "refit", counted)
    process, always = OnlineGp(LAYOUT, (half,)), OnlineGp(LAYOUT, (half,))
    inputs, gamma = pairs(30)
    residuals = gamma - half(inputs)
    for k, query in enumerate(pairs(90, seed=5)[0]):
        if k % 3 == 0:
            process.learn(0, inputs[k // 3], gamma[k // 3])
            always.learn(0, inputs[k // 3], gamma[k // 3])
        always.relearn(0, residuals[: 1 + k // 3])
        found, expected = (each.correct(query[np.newaxis]) for each in (process, always))
        np.testing.assert_array_equal(found.gamma, expected.gamma)
        np.testing.assert_array_equal(found.variance, expected.variance)
    assert len(fitted) <= 90 + 1.1 * 30


def test_it_starts_where_the_paper_starts() -> None:
    np.testing.assert_allclose(np.exp(START.log(1)), [[0.1, 0.5, 0.002]])
    for name in ("signal_variance", "lengthscale", "noise_variance"):
        low, high = getattr(BOUNDS, name)
        assert low <= getattr(START, name) <= high
