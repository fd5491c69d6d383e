"""Loops, modes and residuals, against closed forms and finite differences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import approx_fprime
from scipy.signal import freqs

from nufleet.orchestrator.belief.loop_features import (
    ResponsePrior,
    mode_columns,
    response,
    response_and_slope,
    tap_columns,
    tap_std,
)
from nufleet.shared.arrays import FloatArray

OMEGA = np.linspace(0.1, 5.4, 13)
PRIOR = ResponsePrior(omega_max_rad_s=5.4, decay_min_1_s=0.2)

loops = st.tuples(
    st.floats(0.5, 1.5),
    st.floats(-2.0, 2.0),
    st.floats(0.0, 2.0),
    st.floats(-3.0, 0.5),
    st.floats(-0.2, 0.5),
)
modes = st.tuples(
    st.floats(-1.0, 1.0), st.floats(-1.0, 1.0), st.floats(0.0, 2.0), st.floats(-3.0, 0.0)
)


@given(loop=loops)
def test_a_loop_is_the_transfer_function_it_says(
    loop: tuple[float, float, float, float, float],
) -> None:
    b_0, b_1, log_omega, log_damping, delay_s = loop
    w, damping = np.exp(log_omega), np.exp(log_damping)
    _, oracle = freqs([b_1 / w, b_0], [1 / w**2, 2 * damping / w, 1], OMEGA)
    found = response(np.array(loop), OMEGA)
    np.testing.assert_allclose(found, oracle * np.exp(-1j * OMEGA * delay_s), rtol=1e-9, atol=1e-9)


@settings(max_examples=30)
@given(loop=loops, mode=modes)
def test_slopes_are_those_of_finite_differences(
    loop: tuple[float, ...], mode: tuple[float, ...]
) -> None:
    theta = np.array([*loop, *mode])

    def parts(at: FloatArray) -> FloatArray:
        z = response(at, OMEGA)
        return np.concatenate([z.real, z.imag])

    _, slope = response_and_slope(theta, OMEGA)
    oracle = approx_fprime(theta, parts, 1e-7)
    found = np.concatenate([slope.real, slope.imag])
    np.testing.assert_allclose(found, oracle, atol=2e-5 * max(1.0, float(np.abs(found).max())))


@given(omega_0=st.floats(0.5, 5.0), damping=st.floats(0.02, 1.0))
def test_a_modes_height_is_its_gain_at_resonance(omega_0: float, damping: float) -> None:
    columns = mode_columns(np.array([omega_0]), np.array([damping]), 0.0, np.array([omega_0]))
    np.testing.assert_allclose(np.abs(columns[0, 0]), 1.0, rtol=1e-12)


def test_a_mode_is_the_less_probable_the_slower_it_decays_than_the_robot_says() -> None:
    omega, damping, log_weight = PRIOR.mode_grid()
    decay, weight = omega * damping, np.exp(log_weight)
    for share, probability in ((1.0, 0.2), (0.5, 1e-3), (0.1, 1e-8)):
        slower = float(weight[decay < share * PRIOR.decay_min_1_s].sum())
        assert 0.0 < slower < probability


def test_a_mode_probably_is_what_was_measured_to_decay() -> None:
    stated, known = (replace(PRIOR, decay_min_1_s=0.05, measured=one) for one in (False, True))
    chances = []
    for prior in (stated, known):
        omega, damping, log_weight = prior.mode_grid()
        alike = np.abs(np.log(omega * damping / prior.decay_min_1_s)) < 1
        chances.append(float(np.exp(log_weight)[alike].sum()))
    assert chances[0] < 0.3
    assert 0.5 < chances[1] < 0.7


@given(
    omega_max_rad_s=st.floats(1e-3, 3e3),
    settled=st.floats(1e-3, 1e5),  # ω_max over the slowest decay
    measured=st.booleans(),
)
def test_the_grid_is_a_probability_whatever_the_robot_says(
    omega_max_rad_s: float, settled: float, measured: bool
) -> None:
    prior = ResponsePrior(omega_max_rad_s, omega_max_rad_s / settled, measured)
    omega, damping, log_weight = prior.mode_grid()
    assert omega.shape == damping.shape == log_weight.shape
    assert omega.min() < 0.02 * omega_max_rad_s
    assert omega.max() > 1.2 * omega_max_rad_s
    assert np.exp(log_weight).sum() == pytest.approx(1.0)


def test_the_modes_of_the_grid_lie_closer_than_their_resonances_are_wide() -> None:
    omega, damping, _ = PRIOR.mode_grid()
    for value in np.unique(damping):
        places = np.sort(omega[damping == value])
        assert np.all(np.diff(places) <= 2 * value * places[:-1])


@given(size=st.floats(1e-4, 1.0), memory_s=st.floats(0.3, 10.0))
def test_a_residual_has_the_size_asked_for_at_every_frequency(size: float, memory_s: float) -> None:
    columns = tap_columns(5.4, OMEGA) * tap_std(size, memory_s, 5.4)
    np.testing.assert_allclose(np.sum(np.abs(columns) ** 2, axis=1), size**2, rtol=1e-9)
