"""The weights of a mixture are the most probable ones of sum one; what is old is forgotten."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.optimize import minimize, nnls
from scipy.stats import multivariate_normal

from nufleet.robot_agent.flight.mixture import ERROR_MAX, Mixture
from nufleet.shared.arrays import FloatArray

MODELS, TIMES = 4, 12
START = np.array([0.4, 0.3, 0.2, 0.1])
CONCENTRATION = 3.0
EVEN = np.array([0.5, 0.5])
ONE = np.ones(1)


def predictions(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means (times, models, 2), variances (times, 2), and what was observed (times, 2)."""
    rng = np.random.default_rng(seed)
    seen = rng.standard_normal((TIMES, 2))
    means = (
        seen[:, np.newaxis]
        + rng.standard_normal((TIMES, MODELS, 2))
        + rng.normal(0.0, 1.0, (1, MODELS, 1))
    )
    return means, rng.uniform(0.5, 2.0, (TIMES, 2)), seen


def observed(seed: int, forgetting: float = 1.0, order: list[int] | None = None) -> Mixture:
    chosen = list(range(MODELS)) if order is None else order
    mixture = Mixture(START[chosen], concentration=CONCENTRATION, forgetting=forgetting)
    for mean, variance, seen in zip(*predictions(seed), strict=True):
        mixture.observe(mean[chosen], variance, seen)
    return mixture


def log_posterior(weights: FloatArray, seed: int, forgetting: float) -> float:
    """The logarithm of the posterior density of weights, apart from a constant (scipy)."""
    means, variances, seen = predictions(seed)
    found = 0.0
    for age, (mean, variance, value) in enumerate(
        zip(means[::-1], variances[::-1], seen[::-1], strict=True)
    ):
        density = multivariate_normal(weights @ mean, np.diag(variance)).logpdf(value)
        found += forgetting**age * float(density)
    prior = multivariate_normal(START, np.diag(START / CONCENTRATION)).logpdf(weights)
    return found + float(prior)


@pytest.mark.parametrize("forgetting", [1.0, 0.9])
@pytest.mark.parametrize("seed", range(6))
def test_the_weights_are_the_most_probable_ones_of_sum_one(seed: int, forgetting: float) -> None:
    """Against a general constrained minimiser of the densities that scipy computes."""
    oracle = minimize(
        lambda weights: -log_posterior(weights, seed, forgetting),
        START,
        method="SLSQP",
        bounds=[(0.0, 1.0)] * MODELS,
        constraints={"type": "eq", "fun": lambda weights: weights.sum() - 1.0},
        options={"ftol": 1e-12, "maxiter": 500},
    )
    mixture = observed(seed, forgetting)
    np.testing.assert_allclose(mixture.weights, oracle.x, atol=2e-5)
    assert log_posterior(mixture.weights, seed, forgetting) >= -oracle.fun - 1e-9


@given(
    arrays.arrays(np.float64, (8, 3), elements=st.floats(-100, 100)),
    st.floats(0.01, 100.0),
)
@example(np.full((8, 3), 82.54818387), 1.0)
@settings(deadline=None)
def test_the_weights_are_those_of_non_negative_least_squares(
    errors: FloatArray, concentration: float
) -> None:
    """Against SciPy, with the sum of one as an equation that weighs ten thousand times as much.

    With a million, rounding moved SciPy's weights by 1e-5 where all models err alike.
    """
    start = np.full(8, 0.125)
    mixture = Mixture(start, concentration=concentration)
    mixture.observe(errors, np.ones(3), np.zeros(3))
    prior = np.sqrt(concentration / start)
    heavy = 1e4 * (1 + np.abs(errors).max() + prior.max())
    clipped = np.clip(errors, -ERROR_MAX, ERROR_MAX)
    rows = np.vstack([clipped.T, np.diag(prior), np.full(8, heavy)])
    expected, _ = nnls(rows, np.concatenate([np.zeros(3), prior * start, [heavy]]))
    np.testing.assert_allclose(mixture.weights, expected, atol=1e-5)


def test_two_models_that_err_in_opposite_directions_meet_in_the_middle() -> None:
    """Bayesian model averaging would end with the one that errs less."""
    mixture = Mixture(EVEN)
    for _ in range(2000):
        mixture.observe(np.array([[-1.0], [3.0]]), ONE, np.zeros(1))
    np.testing.assert_allclose(mixture.weights, [0.75, 0.25], atol=1e-3)
    np.testing.assert_allclose(mixture.mean(np.array([[-1.0], [3.0]])), 0.0, atol=3e-3)


@given(
    arrays.arrays(np.float64, (5, MODELS, 2), elements=st.floats(allow_nan=True)),
    arrays.arrays(np.float64, (5, 2), elements=st.floats(1e-9, 1e6)),
    arrays.arrays(np.float64, (5, 2), elements=st.floats(allow_nan=True)),
    st.floats(0.01, 1.0),
    st.floats(0.01, 1.0),
)
@settings(deadline=None)
def test_whatever_is_predicted_and_measured_the_weights_are_shares_of_one(
    means: FloatArray, variances: FloatArray, seen: FloatArray, forgetting: float, ease: float
) -> None:
    mixture = Mixture(START, forgetting=forgetting, ease=ease)
    for mean, variance, value in zip(means, variances, seen, strict=True):
        mixture.observe(mean, variance, value)
        assert (mixture.weights >= 0).all()
        assert mixture.weights.sum() == pytest.approx(1.0)


@given(st.permutations(range(MODELS)), st.integers(0, 100), st.sampled_from([0.9, 1.0]))
@settings(deadline=None)
def test_the_order_of_the_models_does_not_matter(
    order: list[int], seed: int, forgetting: float
) -> None:
    permuted, as_they_came = observed(seed, forgetting, order), observed(seed, forgetting)
    np.testing.assert_allclose(permuted.weights, as_they_came.weights[order], atol=1e-9)


def test_what_is_forgotten_leads_back_to_the_start() -> None:
    mixture = observed(0, 0.9)
    assert np.abs(mixture.weights - START).max() > 0.1
    for _ in range(300):
        mixture.observe(np.zeros((MODELS, 1)), ONE, np.zeros(1))
    np.testing.assert_allclose(mixture.weights, START, rtol=1e-3)


def test_what_all_models_have_in_common_changes_no_weight_from_the_start() -> None:
    mixture = Mixture(START, concentration=CONCENTRATION)
    mixture.observe(np.full((MODELS, 1), 25.0), ONE, np.zeros(1))
    np.testing.assert_allclose(mixture.weights, START, atol=1e-6)


def test_a_model_that_was_wrong_by_very_much_can_return() -> None:
    mixture = Mixture(EVEN, forgetting=0.98)
    mixture.observe(np.array([[0.0], [1e6]]), ONE, np.zeros(1))
    assert mixture.weights[1] < 2 / ERROR_MAX**2
    for _ in range(250):
        mixture.observe(np.array([[3.0], [0.0]]), ONE, np.zeros(1))
    assert mixture.weights[1] > 0.95


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_a_measurement_that_is_not_finite_counts_for_nothing(nothing: float) -> None:
    mixture = observed(3)
    before = mixture.weights
    mixture.observe(np.ones((MODELS, 1)), ONE, np.array([nothing]))
    np.testing.assert_allclose(mixture.weights, before, atol=1e-12)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_a_model_without_a_finite_prediction_counts_as_wrong(nothing: float) -> None:
    mixture = Mixture(EVEN)
    mixture.observe(np.array([[0.0], [nothing]]), ONE, np.zeros(1))
    assert mixture.weights[1] < 2 / ERROR_MAX**2


def test_weights_that_are_eased_go_part_of_the_way() -> None:
    mixture = Mixture(EVEN, ease=0.2)
    for _ in range(3):
        before = mixture.weights
        mixture.observe(np.array([[0.0], [1e3]]), ONE, np.zeros(1))
        np.testing.assert_allclose(mixture.weights, before + 0.2 * (mixture.best - before))


@pytest.mark.parametrize(
    ("start", "changed", "message"),
    [
        ([0.5, 0.6], {}, "add up to 1"),
        ([1.0, 0.0], {}, "must be positive"),
        ([], {}, "add up to 1"),
        ([0.5, 0.5], {"forgetting": 0.0}, "forgetting must be above 0"),
        ([0.5, 0.5], {"ease": 1.1}, "ease must be above 0"),
        ([0.5, 0.5], {"concentration": 0.0}, "concentration must be above 0"),
    ],
)
def test_a_start_that_is_none_is_refused(
    start: list[float], changed: dict[str, float], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Mixture(np.array(start), **changed)
