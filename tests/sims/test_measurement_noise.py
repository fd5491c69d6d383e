"""Measurement noise belongs to a sample, not to the call that asks for it."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nufleet.sims.measurement_noise import MeasurementNoise

SIGMA = np.array([[0.002, 0.01, 0.005], [0.004, 0.0, 0.001]])


def noise(seed: int = 3) -> MeasurementNoise:
    return MeasurementNoise(SIGMA, np.random.default_rng(seed))


@given(st.lists(st.integers(min_value=0, max_value=40), min_size=1, max_size=6))
def test_the_noise_of_a_sample_does_not_depend_on_how_samples_are_taken(parts: list[int]) -> None:
    whole, split = noise(), noise()
    pieces = [split.take(samples) for samples in parts]
    np.testing.assert_array_equal(np.concatenate(pieces), whole.take(sum(parts)))
    np.testing.assert_array_equal(split.now, whole.now)


def test_the_current_noise_is_the_first_that_is_taken_next() -> None:
    source = noise()
    source.take(5)
    now = source.now
    np.testing.assert_array_equal(source.now, now)
    np.testing.assert_array_equal(source.take(2)[0], now)


def test_every_state_has_its_own_standard_deviation_and_no_correlation() -> None:
    draws = noise().take(40_000).reshape(-1, SIGMA.size)
    np.testing.assert_allclose(draws.std(axis=0), SIGMA.ravel(), rtol=0.02)
    quiet = SIGMA.ravel() == 0
    correlation = np.corrcoef(draws[:, ~quiet].T) - np.eye(int((~quiet).sum()))
    assert np.abs(correlation).max() < 0.03
