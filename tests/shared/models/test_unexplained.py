"""What no linear response explains is told apart: what lasts, and the noise of a sensor."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.unexplained import Unexplained, autocovariance

SAMPLES = 20_000
KEPT = 0.9
"""Correlation of what lasts from one sample to the next."""


def noise(std: float, seed: int = 0) -> FloatArray:
    return std * np.random.default_rng(seed).standard_normal(SAMPLES)


def lasting(std: float, seed: int = 1) -> FloatArray:
    """A first-order process with that standard deviation."""
    pushed = noise(std * np.sqrt(1 - KEPT**2), seed)
    return np.asarray(lfilter([1.0], [1.0, -KEPT], pushed))


def test_the_autocovariance_is_the_mean_of_products_a_lag_apart() -> None:
    rows = np.array([[1.0, 2.0, -1.0, 0.5], [0.0, 1.0, 1.0, 1.0]])
    expected = [np.sum(rows[:, : 4 - lag] * rows[:, lag:]) / 8 for lag in range(3)]
    np.testing.assert_allclose(autocovariance(rows, 3), expected, atol=1e-12)


def test_noise_is_white_and_the_rest_lasts() -> None:
    both = lasting(3e-3) + noise(2e-3)
    covariance, variance = Unexplained.of(both, 20, 1.0, 0.0).parts()
    assert variance == pytest.approx(4e-6, rel=0.2)
    np.testing.assert_allclose(covariance, 9e-6 * KEPT ** np.arange(20), atol=2e-6)


def test_noise_alone_lasts_no_longer_than_a_sample() -> None:
    covariance, variance = Unexplained.of(noise(2e-3), 20, 1.0, 2e-3).parts()
    assert variance == pytest.approx(4e-6, rel=0.1)
    assert np.abs(covariance).max() < 0.05 * variance


def test_the_filtered_noise_of_a_sensor_at_rest_is_no_disturbance() -> None:
    """It lasts, too, but a robot that fought it would move for nothing."""
    covariance, variance = Unexplained.of(lasting(3e-3), 20, 1.0, 3e-3).parts()
    assert variance == pytest.approx(9e-6, rel=0.1)
    assert np.abs(covariance).max() < 0.1 * variance


def test_flights_add_up() -> None:
    first = Unexplained.of(lasting(3e-3), 5, 0.01, 1e-3)
    second = Unexplained.of(lasting(1e-3, 2), 5, 0.04, 2e-3)
    both = first + second
    products = np.add(first.products, second.products)
    np.testing.assert_allclose(both.products, products, rtol=1e-12)
    assert both.rows == 2 * SAMPLES
    assert both.error_square == pytest.approx(0.025)


def test_a_flight_shorter_than_the_lags_says_nothing_of_the_longer_ones() -> None:
    short = Unexplained.of(np.array([1.0, -1.0, 1.0, -1.0]), 9, 1.0, 0.0)
    assert short.products[4:] == (0.0,) * 5


def test_what_is_drawn_is_like_what_was_seen() -> None:
    seen = Unexplained.of(lasting(3e-3) + noise(2e-3), 60, 1.0, 0.0)
    drawn = Unexplained.of(seen.drawn(SAMPLES, np.random.default_rng(5)), 60, 1.0, 0.0)
    (covariance, variance), (wanted, noisy) = drawn.parts(), seen.parts()
    assert variance == pytest.approx(noisy, rel=0.3)
    np.testing.assert_allclose(covariance[:10], wanted[:10], atol=1e-6)
