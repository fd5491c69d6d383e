"""Variances that borrow strength from their neighbours."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from nufleet.orchestrator.belief.noise_pooling import pooled_variance

OMEGA = np.linspace(1.0, 5.0, 8)


def measured(true: np.ndarray, segments: int, rng: np.random.Generator) -> np.ndarray:
    degrees = 2 * (segments - 1)
    return np.asarray(true * rng.chisquare(degrees, true.shape) / degrees)


@pytest.mark.parametrize("exponent", [0.0, 1.0, -2.0])
def test_a_power_law_is_found_better_than_by_each_tone_alone(exponent: float) -> None:
    rng = np.random.default_rng(0)
    true = 1e-4 * OMEGA**exponent
    alone, together = [], []
    for _ in range(200):
        found = measured(true, 3, rng)
        alone.append(np.log(found / true))
        together.append(np.log(pooled_variance(OMEGA, found, np.full(8, 4.0)) / true))
    assert np.std(together) < 0.6 * np.std(alone)


@pytest.mark.parametrize(("segments", "unevenness"), [(3, 0.0), (4, 0.0), (4, 1.0)])
def test_errors_over_pooled_deviations_exceed_two_as_rarely_as_normal_ones(
    segments: int, unevenness: float
) -> None:
    rng = np.random.default_rng(1)
    scaled = []
    for _ in range(1500):
        true = 1e-4 * np.exp(unevenness * rng.standard_normal(8))
        error = np.sqrt(true) * rng.standard_normal(8)
        found = measured(true, segments, rng)
        pooled = pooled_variance(OMEGA, found, np.full(8, 2.0 * (segments - 1)))
        scaled.append(error / np.sqrt(pooled))
    beyond = float(np.mean(np.abs(scaled) > 2.0))
    # Never much more often; the allowance for unknown variances may make it rarer.
    assert 0.2 * 2 * norm.sf(2.0) < beyond < 1.35 * 2 * norm.sf(2.0)


def test_a_lone_tone_keeps_its_own_variance_and_an_allowance() -> None:
    found = pooled_variance(np.array([1.0]), np.array([1e-4]), np.array([6.0]))
    assert found[0] == pytest.approx(1e-4 * 6 / 4)


def test_exact_measurements_stay_exact() -> None:
    assert pooled_variance(OMEGA, np.zeros(8), np.full(8, 6.0)).tolist() == [0.0] * 8
