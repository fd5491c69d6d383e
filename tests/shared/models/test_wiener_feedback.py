"""The feedback that leaves least of a disturbance agrees with closed forms, and stays stable."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter
from test_error_belief import BASIS, belief, played

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import ErrorBelief
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.wiener_feedback import WienerFeedback, wiener_feedback

KEPT = 0.98
"""Correlation of the disturbance from one sample to the next."""

LAGS = 300


def covariance(std: float, kept: float = KEPT) -> FloatArray:
    return np.asarray(std**2 * kept ** np.arange(LAGS))


def delay() -> ErrorBelief:
    """A loop that follows one sample late, exactly known."""
    basis = ErrorBasis(0.3, 0.6)
    assert basis.nodes.tolist() == [0, 1, 2]
    return ErrorBelief(basis, np.array([1.0, 0.0, 0.0, 0.0]), np.zeros((4, 1)), 0.0, 10.0)


def feedback(
    known: ErrorBelief,
    disturbance: FloatArray,
    noise_variance: float = 0.0,
    relative_error: float = 0.0,
    acceleration_max: float = 1e6,
) -> WienerFeedback:
    found = wiener_feedback(
        known,
        disturbance,
        noise_variance,
        relative_error=relative_error,
        safe_error=relative_error,
        acceleration_max=acceleration_max,
    )
    assert found is not None
    return found


@pytest.mark.parametrize("kept", [0.5, 0.8])
def test_behind_a_delay_it_predicts_the_disturbance(kept: float) -> None:
    """What is measured one sample ago and acts one sample later is known two samples late, and
    a first-order process is best predicted by its last value, times its correlation over both."""
    found = feedback(delay(), covariance(2e-3, kept))
    np.testing.assert_allclose(found.taps, [-(kept**2), 0.0, 0.0][: len(found.taps)], atol=0.02)
    assert found.variance(covariance(2e-3, kept)) == pytest.approx(4e-6 * (1 - kept**4), rel=0.02)


def test_noise_of_the_sensor_is_let_through() -> None:
    found = feedback(delay(), covariance(1e-5, 0.5), noise_variance=4e-6)
    assert np.abs(found.taps).max() < 1e-4
    assert found.variance(np.array([4e-6])) == pytest.approx(4e-6, rel=1e-3)


def test_without_a_disturbance_there_is_no_feedback() -> None:
    still = np.zeros(LAGS)
    assert (
        wiener_feedback(
            delay(), still, 1e-6, relative_error=0.1, safe_error=0.1, acceleration_max=1.0
        )
        is None
    )


def test_a_loop_leaves_of_its_disturbance_what_was_expected() -> None:
    """By an independent simulation of the closed loop, whose model comes from one noisy test."""
    rng = np.random.default_rng(3)
    noise = 1e-3 * rng.standard_normal(20_000)
    pushed = 5e-3 * np.sqrt(1 - KEPT**2) * rng.standard_normal(len(noise))
    disturbance = lfilter([1.0], [1.0, -KEPT], pushed)
    found = feedback(belief(), covariance(5e-3), 1e-6, 0.1, 1.0)
    left = _flown(found, disturbance, noise, belief())
    expected = found.variance(covariance(5e-3)) + found.variance(np.array([1e-6]))
    assert np.mean(left**2) < 0.7 * np.mean((disturbance + noise) ** 2)
    assert np.mean(left**2) == pytest.approx(expected + found.doubtful, rel=0.15)


@pytest.mark.parametrize("wrong", [-0.2, 0.2])
def test_a_loop_that_differs_by_two_standard_deviations_stays_stable(wrong: float) -> None:
    """Its error response is a fifth larger or smaller than the model of the feedback says."""
    known = belief()
    other = ErrorBelief(BASIS, known.mean / (1 + wrong), known.factor, known.noise_std, 10.0)
    found = feedback(other, covariance(0.05), 1e-6, 0.1, 100.0)
    push = np.zeros(5000)
    push[:100] = 0.05
    left = _flown(found, push, np.zeros(len(push)), other)
    assert np.abs(left[3000:]).max() < 0.01 * np.abs(left).max()


def test_its_corrections_accelerate_no_more_than_they_may() -> None:
    found = feedback(belief(), covariance(5e-3), 1e-6, 0.1, acceleration_max=0.2)
    rng = np.random.default_rng(0)
    pushed = 5e-3 * np.sqrt(1 - KEPT**2) * rng.standard_normal(50_000)
    seen = lfilter([1.0], [1.0, -KEPT], pushed) + 1e-3 * rng.standard_normal(len(pushed))
    corrections = np.convolve(seen, found.taps)
    acceleration = np.diff(corrections, 2) / BASIS.sample_time_s**2
    assert np.sqrt(np.mean(acceleration**2)) < 1.1 * 0.2


def _flown(
    found: WienerFeedback, disturbance: FloatArray, noise: FloatArray, known: ErrorBelief
) -> FloatArray:
    """Return what the true loop of `test_error_belief` measures about its path, at rest at 0."""
    answer = np.diff(played(np.ones(600)))  # the output 1, 2, … samples after an impulse
    model = known.impulse_response()
    samples, memory = len(disturbance), len(answer)
    correction, beyond = np.zeros(samples + memory), np.zeros(samples + memory)
    left = np.zeros(samples)
    for k in range(samples):
        now = k + memory
        recent = beyond[now - len(found.taps) : now][::-1]
        past = correction[now - memory : now][::-1]
        left[k] = past @ answer + disturbance[k] + noise[k]
        correction[now] = recent @ found.taps
        beyond[now] = left[k] - past[: len(model)] @ model[:memory]
    return left
