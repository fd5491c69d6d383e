"""Sinusoids of known frequency are recovered, and segments say how well."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import lfilter

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test import sinusoid_fit
from nufleet.shared.frequency_test.sinusoid_fit import (
    SinusoidFit,
    UnresolvableError,
    fit_sinusoids,
    resolvable_harmonics,
    sum_of_tones,
)

STEP_S = 0.015


def fit_one(
    signal: FloatArray, omega_rad_s: FloatArray, sample_time_s: float, segments: int
) -> SinusoidFit:
    return fit_sinusoids([signal], omega_rad_s, sample_time_s, segments)[0]


def a_period_each(omega_min_rad_s: float) -> int:
    return int(np.ceil(2 * np.pi / omega_min_rad_s / STEP_S))


@settings(deadline=None)
@given(
    st.lists(st.floats(0.5, 100.0), min_size=1, max_size=5),
    st.floats(-10, 10),
    st.floats(-10, 10),
    st.integers(3, 6),
    st.integers(0, 2**32 - 1),
)
def test_phasors_are_recovered_under_any_offset_and_drift(
    omegas: list[float], offset: float, drift: float, segments: int, seed: int
) -> None:
    omega_rad_s = np.array([sum(omegas[: k + 1]) / 3 for k in range(len(omegas))])
    samples = segments * a_period_each(min(omega_rad_s[0], *np.diff(omega_rad_s), 10.0))
    rng = np.random.default_rng(seed)
    true = rng.standard_normal(len(omegas)) + 1j * rng.standard_normal(len(omegas))
    ramp = offset + drift * np.arange(samples) / samples
    signal = sum_of_tones(true, omega_rad_s, STEP_S, samples) + ramp
    fit = fit_one(signal, omega_rad_s, STEP_S, segments)
    np.testing.assert_allclose(fit.phasors, true, atol=1e-9)
    np.testing.assert_allclose(fit.segment_phasors, np.tile(true, (segments, 1)), atol=1e-9)
    np.testing.assert_allclose(fit.fitted, signal, atol=1e-9)


def test_it_is_the_least_squares_solution() -> None:
    rng = np.random.default_rng(3)
    omega_rad_s, samples = np.array([0.9, 1.6, 7.0]), 4 * 500
    signal = rng.standard_normal(samples).cumsum()
    t = np.arange(samples) * STEP_S
    h = np.column_stack([f(w * t) for f in (np.cos, np.sin) for w in omega_rad_s] + [t**0, t])
    theta = np.linalg.lstsq(h, signal, rcond=None)[0]
    fit = fit_one(signal, omega_rad_s, STEP_S, 4)
    np.testing.assert_allclose(fit.phasors, theta[:3] - 1j * theta[3:6], rtol=1e-9)
    np.testing.assert_allclose(fit.fitted, h @ theta, rtol=1e-6, atol=1e-9)


def test_the_mean_of_the_segments_is_the_estimate() -> None:
    signal = np.random.default_rng(3).standard_normal(5 * 321)
    fit = fit_one(signal, np.array([2.0, 5.0]), STEP_S, 5)
    np.testing.assert_allclose(fit.segment_phasors.mean(axis=0), fit.phasors, atol=1e-13)


def test_over_whole_periods_a_segment_says_what_its_own_fourier_sum_says() -> None:
    length, segments = 200, 4
    omega = 2 * np.pi / (length * STEP_S) * 40
    rng = np.random.default_rng(5)
    signal = rng.standard_normal((segments, length))
    t = np.arange(segments * length).reshape(segments, length) * STEP_S
    own: ComplexArray = 2 / length * np.sum(signal * np.exp(-1j * omega * t), axis=1)
    fit = fit_one(signal.ravel(), np.array([omega]), STEP_S, segments)
    # The drift that is removed from the whole signal makes the only difference.
    np.testing.assert_allclose(fit.segment_phasors[:, 0], own, atol=0.01)


def coloured(rng: np.random.Generator, samples: int, memory: float) -> FloatArray:
    noise: FloatArray = lfilter([1.0], [1.0, -memory], rng.standard_normal(samples + 500))[500:]
    return noise


@pytest.mark.thorough
@pytest.mark.parametrize("memory", [0.0, 0.9])
@pytest.mark.parametrize("periods", [1.0, 2.5])
def test_the_variance_is_that_of_the_estimates_in_white_and_coloured_noise(
    memory: float, periods: float
) -> None:
    rng = np.random.default_rng(11)
    length, segments, trials = 100, 4, 800
    omega = np.array([periods * 2 * np.pi / (length * STEP_S)])
    fits = [
        fit_one(coloured(rng, length * segments, memory), omega, STEP_S, segments)
        for _ in range(trials)
    ]
    error = np.mean([abs(fit.phasors[0]) ** 2 for fit in fits])
    assert np.mean([fit.variance[0] for fit in fits]) == pytest.approx(error, rel=0.15)


def test_the_joint_fit_has_less_variance_than_fitting_each_segment_with_its_own_drift() -> None:
    rng = np.random.default_rng(2)
    length, segments, trials = 100, 4, 600
    omega = 2 * np.pi / (length * STEP_S)
    t = np.arange(length) * STEP_S
    own = np.linalg.pinv(np.column_stack([np.cos(omega * t), np.sin(omega * t), t**0, t]))
    joint_error, separate_error = 0.0, 0.0
    for _ in range(trials):
        signal = rng.standard_normal((segments, length))
        joint = fit_one(signal.ravel(), np.array([omega]), STEP_S, segments)
        joint_error += abs(joint.phasors[0]) ** 2
        separate_error += float(np.sum((own[:2] @ signal.T).mean(axis=1) ** 2))
    assert joint_error < 0.65 * separate_error


@given(
    st.lists(st.floats(1.0, 2.5), min_size=0, max_size=4),
    st.floats(1.0, 3.0),
    st.integers(3, 6),
)
def test_in_white_noise_the_variance_is_exactly_that_of_the_estimates_however_close_the_tones(
    beats: list[float], first: float, segments: int
) -> None:
    samples = segments * 30
    base = 2 * np.pi / (samples * STEP_S)
    omega_rad_s = base * np.cumsum([first * segments, *beats])
    # Both are quadratic in the noise, so their expectations are sums over unit impulses.
    fits = fit_sinusoids(list(np.eye(samples)), omega_rad_s, STEP_S, segments)
    expected = np.sum([fit.variance for fit in fits], axis=0)
    true = np.sum([np.abs(fit.phasors) ** 2 for fit in fits], axis=0)
    np.testing.assert_allclose(expected, true, rtol=1e-6)
    # Never more degrees of freedom than the segments have, and at least those of one phasor.
    degrees = fits[0].scatter_degrees
    assert np.all((degrees > 1 - 1e-9) & (degrees < 2 * (segments - 1) + 1e-9))


def test_of_tones_that_a_segment_tells_apart_the_scatter_needs_no_factor() -> None:
    omega_rad_s = 2 * np.pi / (500 * STEP_S) * np.array([10.0, 20.0, 35.0])
    fit = fit_one(np.ones(4 * 500), omega_rad_s, STEP_S, 4)
    np.testing.assert_allclose(fit.scatter_factor, 1.0, atol=1e-3)
    np.testing.assert_allclose(fit.scatter_degrees, 6.0, rtol=1e-3)


def test_as_many_unknowns_as_samples_leave_no_noise_to_measure() -> None:
    omega_rad_s = 2 * np.pi / (12 * STEP_S) * np.array([1.0, 2.0, 3.0, 4.0, 5.0])
    with pytest.raises(UnresolvableError, match="noise"):
        fit_one(np.ones(12), omega_rad_s, STEP_S, 3)


@pytest.mark.parametrize(
    "omega_rad_s", [[1.0, 1.0 + 1e-9], [1.0, np.pi / STEP_S * (1 - 1e-9)], [1e-9]]
)
def test_frequencies_that_cannot_be_told_apart_are_an_error(omega_rad_s: list[float]) -> None:
    with pytest.raises(UnresolvableError):
        fit_one(np.ones(1600), np.array(omega_rad_s), STEP_S, 4)


def test_harmonics_are_the_second_and_third_that_can_be_told_from_all_else() -> None:
    minute = 60.0
    harmonics = resolvable_harmonics(np.array([1.0, 3.02, 80.0]), STEP_S, minute)
    # 3 and 3.02 are closer than a period a minute; 2 × 80 and 3 × 80 are 160 and above Nyquist.
    np.testing.assert_allclose(harmonics, [2.0, 6.04, 160.0, 9.06])
    nothing = resolvable_harmonics(np.array([150.0]), STEP_S, minute)
    assert nothing.shape == (0,)


def test_signals_fitted_together_are_fitted_as_if_alone() -> None:
    signals = list(np.random.default_rng(4).standard_normal((3, 4 * 250)))
    omega_rad_s = np.array([3.0, 7.0])
    together = fit_sinusoids(signals, omega_rad_s, STEP_S, 4)
    for signal, fit in zip(signals, together, strict=True):
        alone = fit_one(signal, omega_rad_s, STEP_S, 4)
        np.testing.assert_allclose(fit.segment_phasors, alone.segment_phasors, atol=1e-13)
        np.testing.assert_allclose(fit.fitted, alone.fitted, atol=1e-13)


def test_a_design_matrix_that_fits_into_memory_is_made_once_with_the_same_result(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    made: list[slice] = []
    columns_of = sinusoid_fit._Columns.__call__
    monkeypatch.setattr(
        sinusoid_fit._Columns,
        "__call__",
        lambda self, block: made.append(block) or columns_of(self, block),
    )
    signal = np.random.default_rng(0).standard_normal(400)
    fits = []
    for most in (sinusoid_fit.KEPT_MAX, 0):
        monkeypatch.setattr(sinusoid_fit, "KEPT_MAX", most)
        fits += fit_sinusoids([signal], np.array([0.5, 1.5]), 0.1, 4)
    assert len(made) == 4 + 2 * 4
    for field in ("phasors", "segment_phasors", "scatter_factor", "fitted"):
        one, other = (getattr(fit, field) for fit in fits)
        assert one.tobytes() == other.tobytes()


def test_robots_that_play_the_same_test_share_one_factorisation(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    factorised: list[int] = []
    cho_factor = sinusoid_fit.cho_factor

    def counting(gram: FloatArray) -> tuple[FloatArray, bool]:
        factorised.append(len(gram))
        factor: tuple[FloatArray, bool] = cho_factor(gram)
        return factor

    monkeypatch.setattr(sinusoid_fit, "cho_factor", counting)
    rng = np.random.default_rng(1)
    for _ in range(20):
        fit_sinusoids([rng.standard_normal(480)], np.array([0.7, 1.9]), 0.1, 4)
    assert factorised == [6]
