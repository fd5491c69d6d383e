"""A sensor that lags is told from robots that are slow, lightly damped or held by friction."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

from nufleet.robot_agent.motion.lag_watch import LagWatch
from nufleet.shared.arrays import FloatArray

SETTLING = 50
SAMPLE_TIME_S = 0.02
TIME_S = SAMPLE_TIME_S * np.arange(2000)
RAMPS_S = (0.5, 4.0, 30.0)


def tone(omega_rad_s: float, ramp_s: float) -> FloatArray:
    return np.asarray(np.minimum(1.0, TIME_S / ramp_s) * np.sin(omega_rad_s * TIME_S))


def answer(reference: FloatArray, damping: float, settling_s: float) -> FloatArray:
    """The output of a loop of second order."""
    omega = 3.0 / (damping * settling_s)
    system = (np.array([omega**2]), np.array([1.0, 2.0 * damping * omega, omega**2]))
    numerator, denominator, _ = cont2discrete(system, SAMPLE_TIME_S)
    return np.asarray(lfilter(numerator.ravel(), denominator, reference))


def late_by(reference: FloatArray, output: FloatArray, batch: int) -> int | None:
    """By how many samples an output is late; in batches, of which plain ones are taken whole."""
    watch = LagWatch(0.0, float(np.ptp(reference)), SETTLING)
    for start in range(0, len(reference), batch):
        some = slice(start, start + batch)
        if batch > 1 and watch.none_in(reference[some], output[some]):
            continue
        for sample, measured in zip(reference[some], output[some], strict=True):
            late = watch.take(float(sample), float(measured))
            if late is not None:
                return late
    return None


@pytest.mark.parametrize("ramp_s", RAMPS_S[:2])
@pytest.mark.parametrize("batch", [1, 2, 13, 256])
def test_an_output_that_begins_to_move_after_the_ramp_and_two_settling_times_is_late(
    ramp_s: float, batch: int
) -> None:
    reference = tone(2.0, ramp_s)
    lag = 200 + math.ceil(ramp_s / SAMPLE_TIME_S)
    output = np.concatenate([np.zeros(lag), answer(reference, 0.7, 1.0)[:-lag]])
    output += 1e-3 * np.random.default_rng(0).standard_normal(len(output))
    late = late_by(reference, output, batch)
    assert late is not None
    assert lag <= late < lag + 100


@settings(max_examples=200, deadline=None)
@given(
    ramp_s=st.floats(0.1, 5.0),
    lag=st.integers(0, 400),
    quiet=st.integers(0, 100),
    noise=st.sampled_from([1e-6, 1e-3, 0.1]),
    batch=st.integers(2, 300),
)
def test_samples_in_batches_are_late_by_as_much_as_one_by_one(
    ramp_s: float, lag: int, quiet: int, noise: float, batch: int
) -> None:
    reference = np.concatenate([np.zeros(quiet), tone(2.0, ramp_s)[:1000]])
    output = np.concatenate([np.zeros(lag), reference])[: len(reference)]
    output += noise * np.random.default_rng(batch).standard_normal(len(output))
    assert late_by(reference, output, batch) == late_by(reference, output, 1)


@pytest.mark.parametrize("batch", [13, 256])
def test_no_batch_of_a_robot_that_follows_needs_a_closer_look(batch: int) -> None:
    reference = tone(2.0, 1.0)
    output = answer(reference, 0.7, 1.0)
    output += 1e-3 * np.random.default_rng(0).standard_normal(len(output))
    watch = LagWatch(0.0, float(np.ptp(reference)), SETTLING)
    for start in range(0, len(reference), batch):
        assert watch.none_in(reference[start : start + batch], output[start : start + batch])


@pytest.mark.parametrize("ramp_s", RAMPS_S)
@pytest.mark.parametrize("damping", [0.03, 0.5, 1.0])
@pytest.mark.parametrize("settling_s", [1.0, 10.0])
@pytest.mark.parametrize("dead", [0.0, 0.5])
def test_no_robot_that_answers_is_late(
    ramp_s: float, damping: float, settling_s: float, dead: float
) -> None:
    """Also one that settles ten times more slowly than stated, or has a wide dead zone."""
    rng = np.random.default_rng(1)
    for omega_rad_s in (0.3, 2.0, 12.0):
        reference = tone(omega_rad_s, ramp_s)
        moving = np.sign(reference) * np.maximum(np.abs(reference) - dead, 0.0)
        output = answer(moving, damping, settling_s)
        for noise in (1e-6, 1e-2):
            measured = output + noise * rng.standard_normal(len(output))
            assert late_by(reference, measured, 256) is None
