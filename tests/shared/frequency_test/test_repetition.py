"""What a robot does in answer to tones repeats with their period, unless it still rings."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.repetition import differences, period_samples

STEP_S = 0.02
OMEGA_RAD_S = np.array([0.5, 2.5, 4.5, 6.5])
PERIOD = round(2 * np.pi / 0.5 / STEP_S)
SAMPLES = PERIOD + 100


def bent_tones() -> FloatArray:
    times_s = STEP_S * np.arange(SAMPLES)
    linear = np.cos(np.outer(times_s, OMEGA_RAD_S) + np.arange(4)).sum(axis=1)
    return np.asarray(linear + 0.05 * linear**2 + 0.02 * linear**3)


def steady() -> FloatArray:
    times_s = STEP_S * np.arange(SAMPLES)
    turning = np.exp(1j * np.outer(times_s, OMEGA_RAD_S))
    drift = np.linspace(-1, 1, SAMPLES)[:, None]
    return np.hstack([turning.real, turning.imag, np.ones_like(drift), drift])


def rates(decay_1_s: float, omega_rad_s: float, block: int) -> FloatArray:
    return block * STEP_S * np.array([[decay_1_s], [omega_rad_s]])


def test_tones_of_the_same_base_repeat_and_others_do_not() -> None:
    assert period_samples(OMEGA_RAD_S, STEP_S, PERIOD, 0) == PERIOD
    assert period_samples(OMEGA_RAD_S, STEP_S, PERIOD + 3, 4) == PERIOD
    assert period_samples(np.append(OMEGA_RAD_S, 3.25), STEP_S, PERIOD, 4) is None


def test_distortion_repeats_with_the_tones() -> None:
    found, _ = differences(bent_tones(), steady(), rates(0.3, 1.3, 2), PERIOD, 2)
    assert found.shape == (50,)
    assert np.std(found) < 0.02 * np.std(bent_tones())


@pytest.mark.parametrize(("decay_1_s", "omega_rad_s"), [(0.3, 1.3), (0.05, 3.1), (2.0, 0.2)])
def test_a_decay_leaves_differences_of_its_own_form(decay_1_s: float, omega_rad_s: float) -> None:
    times_s = STEP_S * np.arange(SAMPLES)
    ringing = np.exp(-decay_1_s * times_s) * np.cos(omega_rad_s * times_s + 1.0)
    output = bent_tones() + ringing
    found, parts = differences(output, steady(), rates(decay_1_s, omega_rad_s, 2), PERIOD, 2)
    own = parts[:, :, 0]
    left = found - own @ np.linalg.lstsq(own, found, rcond=None)[0]
    assert np.std(left) < 0.1 * np.std(found)


def test_a_drift_is_no_difference() -> None:
    drifting = 0.3 * np.linspace(0, 1, SAMPLES)
    found, _ = differences(drifting, steady(), rates(0.3, 1.3, 2), PERIOD, 2)
    assert np.abs(found).max() < 1e-9


def test_a_record_that_is_no_longer_than_a_period_holds_no_differences() -> None:
    output = bent_tones()[:PERIOD]
    found, parts = differences(output, steady()[:PERIOD], rates(0.3, 1.3, 2), PERIOD, 2)
    assert found.shape == (0,)
    assert parts.shape == (0, 2, 1)
