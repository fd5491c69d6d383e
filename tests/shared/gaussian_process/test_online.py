"""The Gaussian process of a control loop against the batch fit."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.shared.arrays import FloatArray
from nufleet.shared.gaussian_process.exact import fit, posterior
from nufleet.shared.gaussian_process.online import OnlineFit
from nufleet.shared.gaussian_process.problem import Batch, Bounds, FitStatus, Hyperparameters

START = Hyperparameters(0.1, 0.5, 0.002)
BOUNDS = Bounds((1e-4, 1e2), (1e-2, 1e2), (1e-6, 1.0))


def online() -> OnlineFit:
    return OnlineFit(capacity=50, dimension=4, outputs=2, start=START, bounds=BOUNDS)


def stream(samples: int) -> tuple[FloatArray, FloatArray]:
    """Return inputs (samples, 4) along a smooth path and two noisy functions of them."""
    rng = np.random.default_rng(0)
    time_s = 0.015 * np.arange(samples)[:, None]
    x = np.sin(time_s * np.array([3.0, 4.0, 5.0, 7.0])) + 0.01 * rng.standard_normal((samples, 4))
    y = np.stack([np.sin(2 * x[:, 0] + x[:, 1]), np.cos(x[:, 2]) * x[:, 3]], axis=1)
    return x, 0.3 * y + 0.05 * rng.standard_normal((samples, 2))


@pytest.mark.parametrize("n", [1, 7, 50])
def test_a_refit_is_the_batch_fit_of_each_output(n: int) -> None:
    x, y = stream(n)
    model = online()
    model.refit(x, y)
    batch = Batch.ragged([x, x], [y[:, 0], y[:, 1]])
    expected = fit(batch, [START], BOUNDS)
    np.testing.assert_array_equal(model.hyperparameters.log(2), expected.hyperparameters.log(2))
    np.testing.assert_array_equal(model.log_marginal_likelihood, expected.log_marginal_likelihood)
    np.testing.assert_array_equal(model.evaluations, expected.evaluations)
    np.testing.assert_array_equal(model.status, expected.status)
    queries = x[:3] + 0.1
    mean, variance = model.predict(queries)
    expected_mean, expected_variance = posterior(batch, expected.hyperparameters, queries)
    np.testing.assert_allclose(mean, expected_mean.T, rtol=1e-12)
    np.testing.assert_allclose(variance, expected_variance.T, rtol=1e-10)


def test_a_moving_window_is_fitted_to_convergence_in_a_few_evaluations() -> None:
    x, y = stream(150)
    model = online()
    evaluations = []
    for last in range(50, 150):
        model.refit(x[last - 50 : last], y[last - 50 : last])
        assert model.status.tolist() == [FitStatus.CONVERGED, FitStatus.CONVERGED]
        evaluations.append(model.evaluations)
    assert np.mean(evaluations[1:]) < 8.0


def test_a_shorter_window_leaves_nothing_of_the_longer_one() -> None:
    x, y = stream(50)
    model, fresh = online(), online()
    model.refit(x, y)
    model.restart()
    model.refit(x[:9], y[:9])
    fresh.refit(x[:9], y[:9])
    np.testing.assert_array_equal(model.hyperparameters.log(2), fresh.hyperparameters.log(2))
    np.testing.assert_array_equal(model.predict(x[9:12]), fresh.predict(x[9:12]))


def test_before_the_first_refit_it_knows_only_the_prior() -> None:
    mean, variance = online().predict(np.zeros((3, 4)))
    np.testing.assert_array_equal(mean, np.zeros((3, 2)))
    np.testing.assert_allclose(variance, np.full((3, 2), 0.1), rtol=1e-15)


def test_a_window_that_cannot_be_right_is_refused_and_the_last_one_stays() -> None:
    x, y = stream(50)
    model = online()
    model.refit(x, y)
    before = model.predict(x[:1])
    holed = x.copy()
    holed[3, 1] = np.nan
    for inputs, targets, message in [
        (holed, y, "finite"),
        (x, np.where(y == y[0], np.inf, y), "finite"),
        (x[:, :3], y, "x must have shape"),
        (np.tile(x, (2, 1)), np.tile(y, (2, 1)), "x must have shape"),
        (x[:0], y[:0], "x must have shape"),
        (x, y[:, :1], "y must have shape"),
    ]:
        with pytest.raises(ValueError, match=message):
            model.refit(inputs, targets)
    np.testing.assert_array_equal(model.predict(x[:1]), before)
    with pytest.raises(ValueError, match="x_query must have shape"):
        model.predict(x[0])
    with pytest.raises(ValueError, match="finite"):
        model.predict(holed)


def test_sizes_below_one_are_refused() -> None:
    with pytest.raises(ValueError, match="at least 1"):
        OnlineFit(capacity=0, dimension=1, outputs=1, start=START, bounds=BOUNDS)
