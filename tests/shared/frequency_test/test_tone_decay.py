"""A transient at the frequency of a tone is found in what the tones leave."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.sinusoid_fit import exponentials
from nufleet.shared.frequency_test.tone_decay import decaying_tone

STEP_S = 0.06
SAMPLES = 900
TIMES_S = STEP_S * np.arange(SAMPLES)
OMEGA = 0.6 * np.arange(1, 10)


def left_by_tones(output: FloatArray) -> FloatArray:
    turning = exponentials(STEP_S * OMEGA, SAMPLES)
    steady = [turning.real, turning.imag, np.ones((SAMPLES, 1)), TIMES_S[:, None]]
    basis = np.linalg.qr(np.concatenate(steady, axis=1))[0]
    return np.asarray(output - basis @ (basis.T @ output))


def test_a_decay_near_a_tone_is_found_at_its_rate_and_frequency() -> None:
    rng = np.random.default_rng(1)
    for _ in range(40):
        decay, omega = rng.uniform(0.05, 0.2), rng.choice(OMEGA[2:]) + rng.uniform(-0.05, 0.05)
        rings = np.exp(-decay * TIMES_S) * np.cos(omega * TIMES_S + rng.uniform(0, 6))
        found = decaying_tone(
            left_by_tones(rings + 0.1 * rng.standard_normal(SAMPLES)), OMEGA, STEP_S
        )
        assert found is not None
        assert 0.4 < found[0] / decay < 2.5
        assert abs(found[1] - omega) < 0.1


def test_a_tone_that_grows_or_shrinks_at_some_moment_does_not_decay() -> None:
    rng = np.random.default_rng(2)
    for _ in range(40):
        tone = np.cos(rng.choice(OMEGA[2:]) * TIMES_S + rng.uniform(0, 6))
        stepped = tone * (rng.uniform(0.2, 0.8) * TIMES_S[-1] < TIMES_S)
        output = stepped + 0.1 * rng.standard_normal(SAMPLES)
        assert decaying_tone(left_by_tones(output), OMEGA, STEP_S) is None


@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_noise_does_not_decay_whatever_its_colour(memory: float) -> None:
    rng = np.random.default_rng(3)
    found = 0
    for _ in range(400):
        noise = lfilter([1.0], [1.0, -memory], rng.standard_normal(SAMPLES + 500))[500:]
        found += decaying_tone(left_by_tones(noise), OMEGA, STEP_S) is not None
    assert found <= 2


def test_nothing_is_said_of_a_tone_of_few_periods() -> None:
    rings = np.exp(-0.1 * TIMES_S) * np.cos(OMEGA[0] * TIMES_S)
    assert decaying_tone(left_by_tones(rings), OMEGA[:1] / 2, STEP_S) is None
