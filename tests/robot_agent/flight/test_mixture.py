"""Weights of models are those of Bayesian model averaging, with what is old forgotten."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays
from scipy.stats import multivariate_normal

from nufleet.robot_agent.flight.mixture import EVIDENCE_MAX, Mixture
from nufleet.shared.arrays import FloatArray

MODELS, TIMES = 4, 30
START = np.array([0.4, 0.3, 0.2, 0.1])
NUMBERS = st.floats(-1e6, 1e6)


def predictions(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Means (times, models, 2), variances of the same shape, and what was observed (times, 2)."""
    rng = np.random.default_rng(seed)
    means = rng.standard_normal((TIMES, MODELS, 2))
    variances = rng.uniform(0.5, 2.0, (TIMES, MODELS, 2))
    return means, variances, rng.standard_normal((TIMES, 2))


def observed(forgetting: float, seed: int, order: list[int] | None = None) -> Mixture:
    chosen = list(range(MODELS)) if order is None else order
    mixture = Mixture(START[chosen], forgetting=forgetting)
    for mean, variance, seen in zip(*predictions(seed), strict=True):
        mixture.observe(mean[chosen], variance[chosen], seen)
    return mixture


def test_without_forgetting_the_weights_are_those_of_exact_bayesian_model_averaging() -> None:
    """Models: constants with a Gaussian prior each, seen through noise.

    Their evidence is one multivariate normal density (scipy), their predictions follow from it.
    """
    rng = np.random.default_rng(1)
    centres, deviation, noise = np.array([0.0, 0.3, 0.5, 2.0]), 0.4, 0.5
    seen = 0.4 + noise * rng.standard_normal(12)
    mixture = Mixture(START)
    for k, value in enumerate(seen):
        precision = 1 / deviation**2 + k / noise**2
        means = (centres / deviation**2 + seen[:k].sum() / noise**2) / precision
        variance = np.array([[1 / precision + noise**2]])
        mixture.observe(means[:, np.newaxis], variance, np.array([value]))
    covariance = deviation**2 * np.ones((12, 12)) + noise**2 * np.eye(12)
    evidence = [multivariate_normal(np.full(12, c), covariance).pdf(seen) for c in centres]
    exact = START * evidence / (START @ evidence)
    np.testing.assert_allclose(mixture.weights, exact, rtol=1e-9)
    np.testing.assert_allclose(mixture.mean(centres[:, np.newaxis]), [exact @ centres], rtol=1e-9)


@given(
    arrays.arrays(np.float64, (5, MODELS, 2), elements=NUMBERS),
    arrays.arrays(np.float64, (5, MODELS, 2), elements=st.floats(1e-9, 1e6)),
    arrays.arrays(np.float64, (5, 2), elements=st.floats(allow_nan=True)),
    st.floats(0.01, 1.0),
)
@settings(deadline=None)
def test_whatever_is_measured_the_weights_add_up_to_one(
    means: FloatArray, variances: FloatArray, seen: FloatArray, forgetting: float
) -> None:
    mixture = Mixture(START, forgetting=forgetting)
    for mean, variance, value in zip(means, variances, seen, strict=True):
        mixture.observe(mean, variance, value)
        assert (mixture.weights > 0).all()
        assert mixture.weights.sum() == pytest.approx(1.0)
        mixed = mixture.mean(mean)
        low, high = mean.min(axis=0), mean.max(axis=0)
        assert (mixed >= low - 1e-6).all()
        assert (mixed <= high + 1e-6).all()


@given(st.permutations(range(MODELS)), st.integers(0, 100), st.sampled_from([0.9, 1.0]))
@settings(deadline=None)
def test_the_order_of_the_models_does_not_matter(
    order: list[int], seed: int, forgetting: float
) -> None:
    permuted, given_ = observed(forgetting, seed, order), observed(forgetting, seed)
    np.testing.assert_allclose(permuted.weights, given_.weights[order], rtol=1e-9)


def test_evidence_that_is_forgotten_leads_back_to_the_start() -> None:
    mixture = observed(0.9, 0)
    assert np.abs(mixture.weights - START).max() > 0.1
    alike = np.zeros((MODELS, 1))
    for _ in range(200):
        mixture.observe(alike, np.ones((1, 1)), np.zeros(1))
    np.testing.assert_allclose(mixture.weights, START, rtol=1e-3)


def test_evidence_of_some_time_ago_counts_as_much_as_its_age_leaves_of_it() -> None:
    mixture = Mixture(np.array([0.5, 0.5]), forgetting=0.9)
    mixture.observe(np.array([[0.0], [2.0]]), np.ones((1, 1)), np.zeros(1))
    alike = np.zeros((2, 1))
    for age in range(4):
        ratio = np.log(mixture.weights[0] / mixture.weights[1])
        assert ratio == pytest.approx(0.9**age * 2.0)
        mixture.observe(alike, np.ones((1, 1)), np.zeros(1))


def test_a_model_that_was_wrong_by_very_much_can_return() -> None:
    mixture = Mixture(np.array([0.5, 0.5]), forgetting=0.98)
    mixture.observe(np.array([[0.0], [1e6]]), np.ones((1, 1)), np.zeros(1))
    assert mixture.weights[1] == pytest.approx(np.exp(-EVIDENCE_MAX), rel=1e-6)
    for _ in range(20):
        mixture.observe(np.array([[3.0], [0.0]]), np.ones((1, 1)), np.zeros(1))
    assert mixture.weights[1] > 0.99


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_a_measurement_that_is_not_finite_changes_nothing(nothing: float) -> None:
    mixture = observed(1.0, 3)
    before = mixture.weights
    mixture.observe(np.ones((MODELS, 1)), np.ones((1, 1)), np.array([nothing]))
    np.testing.assert_array_equal(mixture.weights, before)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_a_model_without_a_finite_prediction_falls_behind(nothing: float) -> None:
    mixture = Mixture(np.array([0.5, 0.5]))
    mixture.observe(np.array([[1.0], [nothing]]), np.ones((1, 1)), np.zeros(1))
    assert mixture.weights[1] == pytest.approx(np.exp(-EVIDENCE_MAX), rel=1e-6)


def test_weights_that_are_eased_go_part_of_the_way_to_the_probabilities() -> None:
    mixture = Mixture(np.array([0.5, 0.5]), ease=0.2)
    for left in (0.4, 0.32, 0.256):
        mixture.observe(np.array([[0.0], [1e3]]), np.ones((1, 1)), np.zeros(1))
        assert mixture.weights[1] == pytest.approx(0.5 * left / 0.5, rel=1e-6)
        assert mixture.weights.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("start", "forgetting", "message"),
    [
        ([0.5, 0.6], 1.0, "add up to 1"),
        ([1.0, 0.0], 1.0, "must be positive"),
        ([], 1.0, "add up to 1"),
        ([0.5, 0.5], 0.0, "above 0"),
        ([0.5, 0.5], 1.1, "above 0"),
    ],
)
def test_a_start_that_is_none_is_refused(
    start: list[float], forgetting: float, message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        Mixture(np.array(start), forgetting=forgetting)
