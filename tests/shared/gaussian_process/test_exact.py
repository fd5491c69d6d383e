"""Exact Gaussian processes against scikit-learn, closed forms and plain NumPy."""

from __future__ import annotations

import warnings
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from sklearn.exceptions import ConvergenceWarning
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import ConstantKernel, Matern, WhiteKernel

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.exact import (
    fit,
    log_marginal_likelihood,
    posterior,
    posterior_weights,
    warm_up,
)
from nufleet.shared.gaussian_process.problem import Batch, Bounds, FitStatus, Hyperparameters

WIDE = Bounds((1e-4, 1e3), (1e-2, 1e3), (1e-6, 1e2))
START = Hyperparameters(0.1, 0.5, 0.002)


def wavy(n: int, d: int, seed: int, noise: float = 0.1) -> tuple[FloatArray, FloatArray]:
    """Return n random inputs (n, d) and noisy samples (n,) of a smooth function."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0.0, 2.0, (n, d))
    return x, np.sin(3.0 * x.sum(axis=1)) + noise * rng.standard_normal(n)


def one_problem(
    x: FloatArray, y: FloatArray, known_noise_variance: FloatArray | None = None
) -> Batch:
    return Batch.ragged([x], [y], None if known_noise_variance is None else [known_noise_variance])


def plain_covariance(x1: FloatArray, x2: FloatArray, h: Hyperparameters) -> FloatArray:
    s = np.sqrt(3.0) * np.linalg.norm(x1[:, None] - x2[None], axis=-1) / h.lengthscale
    return np.asarray(h.signal_variance * (1.0 + s) * np.exp(-s), dtype=np.float64)


def plain_likelihood(x: FloatArray, y: FloatArray, known: FloatArray, h: Hyperparameters) -> float:
    covariance = plain_covariance(x, x, h) + np.diag(known + h.noise_variance)
    _, log_determinant = np.linalg.slogdet(covariance)
    quadratic = y @ np.linalg.solve(covariance, y)
    return float(-0.5 * (quadratic + log_determinant + len(y) * np.log(2.0 * np.pi)))


def sklearn_regressor(start: Hyperparameters, bounds: Bounds, **options: Any) -> Any:
    kernel = ConstantKernel(float(start.signal_variance), bounds.signal_variance) * Matern(
        float(start.lengthscale), bounds.lengthscale, nu=1.5
    ) + WhiteKernel(float(start.noise_variance), bounds.noise_variance)
    return GaussianProcessRegressor(kernel, alpha=0.0, **options)


@pytest.mark.parametrize(("n", "d"), [(1, 1), (7, 2), (50, 5)])
def test_the_weights_of_a_posterior_give_the_means_of_any_targets(n: int, d: int) -> None:
    x, y = wavy(n, d, seed=n)
    targets = np.stack([y, y**2, np.ones(n)])
    h, query = Hyperparameters(0.7, 0.4, 0.02), np.full(d, 0.3)
    mean, variance = posterior(Batch.stacked(x, targets), h, query[np.newaxis])
    weights, found = posterior_weights(x, h, query)
    np.testing.assert_allclose(targets @ weights, mean[:, 0], rtol=1e-6, atol=1e-9)
    assert found == pytest.approx(variance[0, 0], rel=1e-6)


@pytest.mark.parametrize(
    ("n", "d"), [(1, 1), (2, 1), (3, 2), (7, 1), (8, 1), (15, 3), (16, 1), (17, 2), (50, 4)]
)
def test_likelihood_gradient_and_posterior_are_those_of_scikit_learn(n: int, d: int) -> None:
    x, y = wavy(n, d, seed=n)
    h = Hyperparameters(0.7, 0.4, 0.02)
    oracle = sklearn_regressor(h, WIDE, optimizer=None).fit(x, y)
    expected, expected_gradient = oracle.log_marginal_likelihood(
        oracle.kernel_.theta, eval_gradient=True
    )
    value, gradient = log_marginal_likelihood(one_problem(x, y), h)
    assert value[0] == pytest.approx(expected, rel=1e-12, abs=1e-9)
    np.testing.assert_allclose(gradient[0], expected_gradient, rtol=1e-9, atol=1e-9)

    queries = np.concatenate([np.random.default_rng(0).uniform(-1.0, 3.0, (137, d)), x])
    expected_mean, deviation = oracle.predict(queries, return_std=True)
    mean, variance = posterior(one_problem(x, y), h, queries)
    np.testing.assert_allclose(mean[0], expected_mean, rtol=0, atol=1e-9)
    np.testing.assert_allclose(variance[0], deviation**2 - 0.02, rtol=0, atol=1e-9)


@st.composite
def noisy_problems(draw: st.DrawFn) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Inputs (n, d), targets (n,) and known noise variances (n,)."""
    n, d = draw(st.integers(1, 12)), draw(st.integers(1, 3))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    return rng.uniform(-1, 1, (n, d)), rng.standard_normal(n), rng.uniform(0.0, 0.5, n)


def hyperparameters() -> st.SearchStrategy[Hyperparameters]:
    return st.builds(
        lambda f, ell, n: Hyperparameters(10.0**f, 10.0**ell, 10.0**n),
        st.floats(-2, 1),
        st.floats(-1.5, 1),
        st.floats(-3, 0),
    )


@given(noisy_problems(), hyperparameters())
@settings(deadline=None)
def test_known_noise_adds_to_the_learned_one(
    problem: tuple[FloatArray, FloatArray, FloatArray], h: Hyperparameters
) -> None:
    x, y, known = problem
    value, _ = log_marginal_likelihood(one_problem(x, y, known), h)
    assert value[0] == pytest.approx(plain_likelihood(x, y, known, h), rel=1e-9, abs=1e-9)

    queries = np.linspace(-1, 1, 5)[:, None] * np.ones((1, x.shape[1]))
    mean, variance = posterior(one_problem(x, y, known), h, queries)
    covariance = plain_covariance(x, x, h) + np.diag(known + h.noise_variance)
    cross = plain_covariance(x, queries, h)
    solved = np.linalg.solve(covariance, cross)
    np.testing.assert_allclose(mean[0], solved.T @ y, rtol=1e-8, atol=1e-8)
    expected = h.signal_variance - np.sum(cross * solved, axis=0)
    np.testing.assert_allclose(variance[0], expected, rtol=1e-8, atol=1e-8)


@given(noisy_problems(), hyperparameters())
@settings(deadline=None)
def test_gradient_is_the_slope_of_the_likelihood(
    problem: tuple[FloatArray, FloatArray, FloatArray], h: Hyperparameters
) -> None:
    batch = one_problem(*problem)
    _, gradient = log_marginal_likelihood(batch, h)
    theta = h.log(1)
    for i in range(3):
        step = 1e-5 * np.eye(3)[i]
        above, _ = log_marginal_likelihood(batch, Hyperparameters.from_log(theta + step))
        below, _ = log_marginal_likelihood(batch, Hyperparameters.from_log(theta - step))
        slope = (above[0] - below[0]) / 2e-5
        assert gradient[0, i] == pytest.approx(slope, rel=1e-5, abs=1e-5)


@given(noisy_problems())
@settings(deadline=None, max_examples=50)
def test_a_converged_fit_is_stationary_within_the_bounds_and_no_worse_than_its_start(
    problem: tuple[FloatArray, FloatArray, FloatArray],
) -> None:
    batch = one_problem(*problem)
    found = fit(batch, [START], WIDE, evaluations_max=5000)
    assert found.status[0] == FitStatus.CONVERGED
    value, gradient = log_marginal_likelihood(batch, found.hyperparameters)
    assert found.log_marginal_likelihood[0] == pytest.approx(value[0], abs=1e-9)
    theta = found.hyperparameters.log(1)[0]
    lower, upper = WIDE.log()
    assert np.all((theta > lower - 1e-12) & (theta < upper + 1e-12))
    uphill = np.clip(theta + gradient[0], lower, upper) - theta
    assert np.max(np.abs(uphill)) < 1e-6
    assert value[0] >= log_marginal_likelihood(batch, START)[0][0]


@pytest.mark.parametrize("seed", range(8))
@pytest.mark.parametrize(("n", "d"), [(10, 1), (40, 1), (50, 4)])
def test_the_optimum_is_no_worse_than_scikit_learns_from_the_same_start(
    n: int, d: int, seed: int
) -> None:
    x, y = wavy(n, d, seed, noise=0.05)
    found = fit(one_problem(x, y), [START], WIDE)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", ConvergenceWarning)
        oracle = sklearn_regressor(START, WIDE).fit(x, y)
    assert found.status[0] == FitStatus.CONVERGED
    assert found.log_marginal_likelihood[0] >= oracle.log_marginal_likelihood_value_ - 1e-6


def test_problems_of_different_sizes_are_fitted_as_if_alone() -> None:
    sizes = [1, 9, 2, 40, 7, 16, 3]
    pairs = [wavy(n, 2, seed=n) for n in sizes]
    known = [np.full(n, 0.01 * n) for n in sizes]
    batch = Batch.ragged([x for x, _ in pairs], [y for _, y in pairs], known)
    together = fit(batch, [START], WIDE)
    queries = np.random.default_rng(0).uniform(0, 2, (70, 2))
    mean, variance = posterior(batch, together.hyperparameters, queries)
    for p, (x, y) in enumerate(pairs):
        single = one_problem(x, y, known[p])
        alone = fit(single, [START], WIDE)
        assert together.log_marginal_likelihood[p] == alone.log_marginal_likelihood[0]
        assert together.evaluations[p] == alone.evaluations[0]
        np.testing.assert_array_equal(
            together.hyperparameters.log(len(sizes))[p], alone.hyperparameters.log(1)[0]
        )
        mean_alone, variance_alone = posterior(single, alone.hyperparameters, queries)
        np.testing.assert_array_equal(mean[p], mean_alone[0])
        np.testing.assert_array_equal(variance[p], variance_alone[0])


def test_threads_and_repetition_change_nothing() -> None:
    rng = np.random.default_rng(3)
    batch = Batch.stacked(np.linspace(0, 1, 9), rng.standard_normal((200, 9)))
    fits = [fit(batch, [START], WIDE, threads=threads) for threads in (1, 3, 3)]
    for other in fits[1:]:
        np.testing.assert_array_equal(
            other.hyperparameters.log(200), fits[0].hyperparameters.log(200)
        )
        np.testing.assert_array_equal(other.status, fits[0].status)
    grid = np.linspace(0, 1, 11)
    one = posterior(batch, fits[0].hyperparameters, grid, threads=1)
    three = posterior(batch, fits[0].hyperparameters, grid, threads=3)
    np.testing.assert_array_equal(one, three)


def test_where_memory_lies_changes_nothing() -> None:
    x, y = wavy(40, 2, seed=40)
    rng = np.random.default_rng(0)
    found = set()
    for _ in range(100):
        elsewhere = [np.empty(size) for size in rng.integers(1, 2000, 3)]
        result = fit(one_problem(x, y), [START], WIDE)
        found.add(result.hyperparameters.log(1).tobytes())
        del elsewhere
    assert len(found) == 1


def test_inputs_may_be_shared_or_each_problems_own() -> None:
    x = np.linspace(0, 1, 6)
    y = np.random.default_rng(0).standard_normal((3, 6))
    shared = Batch.stacked(x, y, np.array([0.01, 0.02, 0.03])[:, None])
    own = Batch.ragged([x] * 3, list(y), [np.full(6, v) for v in (0.01, 0.02, 0.03)])
    stacked = Batch.stacked(
        np.tile(x, (3, 1))[:, :, None], y, own.known_noise_variance.reshape(3, 6)
    )
    expected, _ = log_marginal_likelihood(own, START)
    np.testing.assert_array_equal(log_marginal_likelihood(shared, START)[0], expected)
    np.testing.assert_array_equal(log_marginal_likelihood(stacked, START)[0], expected)


@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_other_units_give_the_same_fit_in_those_units(scale: float) -> None:
    x, y = wavy(20, 1, seed=4)
    stretch = 1e3
    found = fit(one_problem(x, y), [START], WIDE)
    bounds = Bounds(
        (1e-4 * scale**2, 1e3 * scale**2), (1e-2 * stretch, 1e6), (1e-6 * scale**2, 1e2 * scale**2)
    )
    start = Hyperparameters(0.1 * scale**2, 0.5 * stretch, 0.002 * scale**2)
    scaled = fit(one_problem(stretch * x, scale * y), [start], bounds)
    assert scaled.status[0] == FitStatus.CONVERGED
    expected = found.log_marginal_likelihood[0] - 20 * np.log(scale)
    assert scaled.log_marginal_likelihood[0] == pytest.approx(expected, abs=1e-8)
    ratio = scaled.hyperparameters.log(1) - found.hyperparameters.log(1)
    np.testing.assert_allclose(ratio[0], np.log([scale**2, stretch, scale**2]), atol=1e-5)


def test_one_point_is_explained_by_its_square() -> None:
    found = fit(one_problem(np.array([0.3]), np.array([0.8])), [START], WIDE)
    h = found.hyperparameters
    assert found.status[0] == FitStatus.CONVERGED
    assert h.signal_variance[0] + h.noise_variance[0] == pytest.approx(0.64, rel=1e-6)
    expected = -0.5 * (np.log(2 * np.pi * 0.64) + 1.0)
    assert found.log_marginal_likelihood[0] == pytest.approx(expected, abs=1e-12)


def test_zero_targets_need_no_variance() -> None:
    x = np.linspace(0, 1, 8)
    found = fit(one_problem(x, np.zeros(8)), [START], WIDE)
    assert found.status[0] == FitStatus.CONVERGED
    assert found.hyperparameters.signal_variance[0] == pytest.approx(1e-4, rel=1e-6)
    assert found.hyperparameters.noise_variance[0] == pytest.approx(1e-6, rel=1e-6)
    mean, variance = posterior(one_problem(x, np.zeros(8)), found.hyperparameters, x)
    np.testing.assert_array_equal(mean, 0.0)
    assert np.all((variance >= 0.0) & (variance <= 1e-4))


def test_noise_can_be_fixed_and_can_be_all_known() -> None:
    x, y = wavy(12, 1, seed=5)
    fixed = fit(one_problem(x, y), [START], Bounds((1e-4, 1e3), (1e-2, 1e3), (0.03, 0.03)))
    assert fixed.hyperparameters.noise_variance[0] == pytest.approx(0.03, rel=1e-14)
    known = Bounds((1e-4, 1e3), (1e-2, 1e3), (0.0, 0.0))
    from_known = fit(one_problem(x, y, np.full(12, 0.03)), [START], known)
    assert from_known.hyperparameters.noise_variance[0] == 0.0
    assert from_known.status[0] == fixed.status[0] == FitStatus.CONVERGED
    assert from_known.log_marginal_likelihood[0] == pytest.approx(
        fixed.log_marginal_likelihood[0], abs=1e-9
    )
    np.testing.assert_allclose(
        from_known.hyperparameters.log(1)[0, :2], fixed.hyperparameters.log(1)[0, :2], atol=1e-5
    )


def test_repeated_points_without_noise_get_a_recorded_jitter() -> None:
    x = np.repeat(np.linspace(0, 1, 5), 2)
    y = np.sin(6 * x)
    noiseless = Bounds((1e-4, 1e3), (1e-2, 1e3), (0.0, 0.0))
    found = fit(one_problem(x, y), [START], noiseless)
    assert found.status[0] in (FitStatus.CONVERGED, FitStatus.PRECISION_LIMIT)
    assert 0.0 < found.jitter[0] <= 1e-5
    mean, variance = posterior(one_problem(x, y), found.hyperparameters, x)
    np.testing.assert_allclose(mean[0], y, atol=1e-4)
    assert np.all((variance >= 0.0) & (variance < 1e-3))


def test_rounding_makes_no_variance_negative() -> None:
    x = np.linspace(0, 1, 40)
    noiseless = Hyperparameters(0.7, 0.2, 0.0)
    _, at_points = posterior(one_problem(x, np.sin(x)), noiseless, x)
    assert np.all((at_points >= 0.0) & (at_points < 1e-14))
    assert np.any(at_points == 0.0)
    _, between = posterior(one_problem(x, np.sin(x)), noiseless, 0.5 * (x[1:] + x[:-1]))
    assert np.all(between > 1e-6)


def test_repeated_points_with_noise_need_no_jitter() -> None:
    x = np.repeat(np.linspace(0, 1, 5), 8)
    y = np.sin(6 * x) + 0.1 * np.random.default_rng(1).standard_normal(40)
    found = fit(one_problem(x, y), [START], WIDE)
    assert found.status[0] == FitStatus.CONVERGED
    assert found.jitter[0] == 0.0
    assert found.hyperparameters.noise_variance[0] == pytest.approx(0.01, rel=0.5)


def test_what_overflows_has_a_status_and_spares_its_neighbours() -> None:
    x, y = wavy(10, 1, seed=6)
    batch = Batch.ragged([x, x, x], [y, 1e200 * y, y])
    found = fit(batch, [START], WIDE)
    assert found.status.tolist() == [FitStatus.CONVERGED, FitStatus.FAILED, FitStatus.CONVERGED]
    assert found.log_marginal_likelihood[1] == -np.inf
    assert found.hyperparameters.lengthscale[1] == pytest.approx(0.5)
    mean, variance = posterior(batch, found.hyperparameters, np.array([0.5]))
    assert mean[1, 0] == 0.0
    assert variance[1, 0] == pytest.approx(0.1)
    np.testing.assert_array_equal(mean[0], mean[2])
    value, gradient = log_marginal_likelihood(batch, found.hyperparameters)
    assert value[1] == -np.inf
    np.testing.assert_array_equal(gradient[1], 0.0)


@given(st.integers(100, 170), st.integers(0, 5))
@settings(deadline=None)
def test_enormous_targets_end_within_bounds_and_with_a_status(exponent: int, seed: int) -> None:
    x, y = wavy(6, 1, seed)
    found = fit(one_problem(x, 10.0**exponent * y), [START], WIDE, evaluations_max=100)
    theta = found.hyperparameters.log(1)[0]
    lower, upper = WIDE.log()
    assert np.all((theta > lower - 1e-12) & (theta < upper + 1e-12))
    overflowed = not np.isfinite(found.projected_gradient[0])
    allowed = (FitStatus.FAILED, FitStatus.PRECISION_LIMIT) if overflowed else tuple(FitStatus)
    assert found.status[0] in allowed


def test_a_search_cut_short_says_so_and_keeps_its_best() -> None:
    batch = one_problem(*wavy(30, 1, seed=7))
    cut = fit(batch, [START], WIDE, evaluations_max=3)
    assert cut.status[0] == FitStatus.EVALUATION_LIMIT
    assert cut.evaluations[0] == 3
    assert cut.log_marginal_likelihood[0] > log_marginal_likelihood(batch, START)[0][0]


def test_several_starts_keep_the_best_of_their_maxima() -> None:
    rng = np.random.default_rng(8)
    batch = Batch.stacked(np.linspace(0, 1, 4), rng.standard_normal((60, 4)))
    starts = WIDE.starts(START, 3)
    several = fit(batch, starts, WIDE)
    singles = np.array([fit(batch, [start], WIDE).log_marginal_likelihood for start in starts])
    np.testing.assert_array_equal(several.log_marginal_likelihood, singles.max(axis=0))
    assert np.any(singles[0] < singles.max(axis=0) - 1e-3)


def test_every_problem_may_have_its_own_start() -> None:
    pairs = [wavy(20, 1, seed) for seed in range(3)]
    batch = Batch.ragged([x for x, _ in pairs], [y for _, y in pairs])
    cold = fit(batch, [START], WIDE)
    warm = fit(batch, [cold.hyperparameters], WIDE)
    np.testing.assert_array_equal(warm.evaluations, 1)
    assert np.all(cold.evaluations > 3)


def test_read_only_arrays_are_welcome() -> None:
    x, y = wavy(5, 1, seed=9)
    x.flags.writeable = y.flags.writeable = False
    batch = one_problem(x, y)
    assert np.isfinite(fit(batch, [START], WIDE).log_marginal_likelihood[0])
    queries = x.copy()
    queries.flags.writeable = False
    assert posterior(batch, START, queries)[0].shape == (1, 5)


def test_warming_up_loads_the_core() -> None:
    import sys

    warm_up()
    assert "nufleet.shared.gaussian_process.core" in sys.modules


@pytest.mark.parametrize(
    ("inputs", "targets", "known"),
    [
        ([[np.nan, 1.0]], [[0.0, 1.0]], None),
        ([[0.0, 1.0]], [[0.0, np.inf]], None),
        ([[0.0, 1.0]], [[0.0, 1.0]], [[0.1, np.nan]]),
        ([[0.0, 1.0]], [[0.0, 1.0]], [[0.1, -0.1]]),
        ([[0.0, 1.0]], [[0.0]], None),
        ([[0.0, 1.0]], [[0.0, 1.0]], [[0.1]]),
        ([[0.0], [1.0]], [[0.0]], None),
        ([[]], [[]], None),
        ([], [], None),
    ],
)
def test_problems_that_cannot_be_right_are_refused(
    inputs: list[list[float]], targets: list[list[float]], known: list[list[float]] | None
) -> None:
    with pytest.raises(ValueError, match=r"must|needs"):
        Batch.ragged(
            [np.array(x) for x in inputs],
            [np.array(y) for y in targets],
            None if known is None else [np.array(v) for v in known],
        )


def test_arguments_that_cannot_be_right_are_refused() -> None:
    batch = one_problem(*wavy(5, 2, seed=0))
    with pytest.raises(ValueError, match="at least one start"):
        fit(batch, [], WIDE)
    with pytest.raises(ValueError, match="broadcast"):
        fit(batch, [Hyperparameters([0.1, 0.1], 0.5, 0.1)], WIDE)
    with pytest.raises(ValueError, match="x_query"):
        posterior(batch, START, np.zeros(3))
    with pytest.raises(ValueError, match="x_query"):
        posterior(batch, START, np.array([[0.0, np.nan]]))
    with pytest.raises(ValueError, match="lengthscale"):
        Hyperparameters(0.1, 0.0, 0.1)
    with pytest.raises(ValueError, match="noise_variance"):
        Hyperparameters(0.1, 1.0, -0.1)
    with pytest.raises(ValueError, match="signal_variance"):
        Hyperparameters(np.nan, 1.0, 0.1)
    for low, high in [(0.0, 0.0), (2.0, 1.0), (0.0, 1.0), (1.0, np.inf), (np.nan, 1.0)]:
        with pytest.raises(ValueError, match="lengthscale"):
            Bounds((0.1, 1.0), (low, high), (0.1, 1.0))
    with pytest.raises(ValueError, match="targets must have shape"):
        Batch.stacked(np.zeros(3), np.zeros(3))
    with pytest.raises(ValueError, match="offsets"):
        Batch(np.zeros((3, 1)), np.zeros(3), np.zeros(3), np.array([0, 2]))
    with pytest.raises(ValueError, match="at least one point"):
        Batch(np.zeros((3, 1)), np.zeros(3), np.zeros(3), np.array([0, 0, 3]))
