"""What a test is expected to be worth, against doing it many times."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import norm

from nufleet.orchestrator.study.value_of_tests import expected_gain

SAMPLES = 4000


def two_sources(rng: np.random.Generator, lead: float) -> tuple[np.ndarray, np.ndarray]:
    """Return ψ* of two sources, and the second one's response, which decides it."""
    part = rng.standard_normal((SAMPLES, 1))
    psi_star = np.stack([np.full(SAMPLES, 0.3), 0.3 + lead + 0.05 * part[:, 0]])
    return psi_star, 0.05 * part + 0j


@pytest.mark.parametrize("lead", [0.0, 0.03, 0.1])
@pytest.mark.parametrize("noise", [0.01, 0.1])
def test_it_is_what_the_test_gains_when_it_is_done_many_times(lead: float, noise: float) -> None:
    rng = np.random.default_rng([int(100 * lead), int(100 * noise)])
    psi_star, z = two_sources(rng, lead)
    found = expected_gain(psi_star, 0, z, np.array([2 * noise**2]), epsilon=0.0)
    # Conjugate normal: the posterior of d after seeing d + N(0, noise²).
    d = lead + 0.05 * rng.standard_normal(100_000)
    seen = d + noise * rng.standard_normal(100_000)
    weight = 0.05**2 / (0.05**2 + noise**2)
    after = norm.sf(np.abs(lead + weight * (seen - lead)) / (0.05 * np.sqrt(1 - weight))).mean()
    before = norm.sf(lead / 0.05)
    assert found == pytest.approx(before - after, abs=0.01)


@pytest.mark.parametrize("lead", [0.02, -0.02])
def test_a_test_of_what_does_not_matter_is_worth_nothing(lead: float) -> None:
    rng = np.random.default_rng(0)
    psi_star, _ = two_sources(rng, lead)
    unrelated = rng.standard_normal((SAMPLES, 8)) + 1j * rng.standard_normal((SAMPLES, 8))
    found = expected_gain(psi_star, 0, unrelated, np.full(8, 1e-6), epsilon=0.01)
    assert found == pytest.approx(0.0, abs=0.01)


def test_less_noise_is_never_worth_less() -> None:
    psi_star, z = two_sources(np.random.default_rng(0), 0.02)
    gains = [
        expected_gain(psi_star, 0, z, np.array([variance]), epsilon=0.01)
        for variance in (1e-1, 1e-2, 1e-3, 1e-4)
    ]
    assert gains == sorted(gains)


def test_with_one_source_there_is_nothing_to_find_out() -> None:
    z = np.ones((10, 1), dtype=complex)
    assert expected_gain(np.full((1, 10), 0.2), 0, z, np.array([1e-4]), 0.01) == 0.0
