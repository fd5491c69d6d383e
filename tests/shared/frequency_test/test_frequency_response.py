"""A frequency test gives z(ω) with a disc that covers it."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import f

from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.quality import uncertainty_radius
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings


def a_test_on(
    robot: DoubleIntegrator, *omegas_rad_s: float, segments: int = 4, segment_min_s: float = 0.0
) -> tuple[ExcitationPlan, FloatArray, FloatArray]:
    """Fly one test; the tones' phases keep the peak of their sum low."""
    tones = tuple(
        Tone(omega_rad_s=omega, phase_rad=np.pi * k**2 / len(omegas_rad_s))
        for k, omega in enumerate(omegas_rad_s)
    )
    excitation = Excitation(axis="x", tones=tones, segments=segments, segment_min_s=segment_min_s)
    plan = plan_excitation(excitation, robot.spec, "r1")
    reference = reference_of(plan)
    robot.connect()
    response = robot.run(reference[:, None])[:, 0]
    robot.disconnect()
    return plan, reference, response


def section_v_target(noise_std_m: float = 0.0, seed: int = 0) -> DoubleIntegrator:
    chosen = DoubleIntegratorSettings(alpha=0.85, beta=0.003, noise_std_m=noise_std_m)
    return DoubleIntegrator(chosen, np.random.default_rng(seed))


def closed_form(robot: DoubleIntegrator, omega_rad_s: FloatArray) -> ComplexArray:
    model = robot.spec.axis("x").model
    assert model is not None
    return model.frequency_response(omega_rad_s)


def measure(
    robot: DoubleIntegrator, *omegas_rad_s: float, segments: int = 4, segment_min_s: float = 0.0
) -> FrequencyResponse:
    plan, reference, response = a_test_on(
        robot, *omegas_rad_s, segments=segments, segment_min_s=segment_min_s
    )
    return estimate_frequency_response(reference, response, plan)


@pytest.mark.parametrize(
    "omegas_rad_s",
    [
        *((omega,) for omega in (0.05, 0.1, 0.31, 1.0, 2.7, 4.5, 7.7, 10.0, 50.0)),
        (0.05, 10.0),
        (0.5, 1.0, 1.5, 2.0, 3.0, 5.0, 10.0),
        tuple(np.linspace(0.3, 10.0, 27)),
    ],
)
def test_a_test_without_noise_measures_the_closed_form(omegas_rad_s: tuple[float, ...]) -> None:
    robot = section_v_target()
    measured = measure(robot, *omegas_rad_s, segment_min_s=2 * np.pi / min(omegas_rad_s))
    expected = closed_form(robot, measured.omega_rad_s)
    assert measured.quality.usable
    assert measured.quality.warnings == ()
    np.testing.assert_array_equal(measured.omega_rad_s, omegas_rad_s)
    assert np.max(chordal_distance(measured.z, expected)) < 1e-6


@settings(deadline=None, max_examples=40)
@given(st.floats(0.05, 10.0), st.integers(3, 8))
def test_any_tone_of_the_band_is_measured_closely(omega: float, segments: int) -> None:
    robot = section_v_target()
    measured = measure(robot, omega, segments=segments)
    expected = closed_form(robot, measured.omega_rad_s)
    assert chordal_distance(measured.z, expected)[0] < 1e-6
    assert measured.quality.usable


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("omegas_rad_s", "segments", "trials"),
    [
        ((4.5,), 4, 400),
        ((4.5,), 3, 400),
        ((1.0, 2.0, 4.5, 9.0), 4, 150),
    ],
)
def test_discs_cover_as_often_as_they_say_with_noise_of_one_percent(
    omegas_rad_s: tuple[float, ...], segments: int, trials: int
) -> None:
    robot = section_v_target()
    plan, reference, _ = a_test_on(robot, *omegas_rad_s, segments=segments)
    z = closed_form(robot, np.array(omegas_rad_s))
    noisy = section_v_target(noise_std_m=0.01 * plan.amplitude)
    inside = np.zeros(len(omegas_rad_s))
    for _ in range(trials):
        noisy.connect()
        response = noisy.run(reference[:, None])[:, 0]
        measured = estimate_frequency_response(reference, response, plan)
        assert measured.quality.usable
        inside += np.abs(measured.z - z) <= measured.radius(alpha=0.05)
    # Four standard deviations of a binomial around 0.95.
    np.testing.assert_allclose(inside / trials, 0.95, atol=4 * np.sqrt(0.95 * 0.05 / trials))


@pytest.mark.thorough
@pytest.mark.parametrize(
    ("omegas_rad_s", "segments"),
    [
        ((4.5, 4.8), 3),
        (tuple(np.arange(3, 28, 2) / 3), 3),
        (tuple(np.arange(3, 28, 2) / 4), 4),
        (tuple(np.arange(20, 29, 2) / 6), 6),
    ],
)
def test_discs_of_tones_that_no_segment_tells_apart_cover_as_often_as_they_say(
    omegas_rad_s: tuple[float, ...], segments: int
) -> None:
    robot, rng, trials = section_v_target(), np.random.default_rng(7), 1200 // len(omegas_rad_s)
    plan, reference, clean = a_test_on(robot, *omegas_rad_s, segments=segments)
    z = closed_form(robot, np.array(omegas_rad_s))
    errors, variances, covered = [], [], []
    for _ in range(trials):
        noise = 0.01 * plan.amplitude * rng.standard_normal(len(clean))
        measured = estimate_frequency_response(reference, clean + noise, plan)
        errors.append(np.abs(measured.z - z) ** 2)
        variances.append(measured.variance)
        covered.append(np.sqrt(errors[-1]) <= measured.radius(alpha=0.05))
    assert np.mean(variances) == pytest.approx(np.mean(errors), rel=0.12)
    # Three standard deviations below; Satterthwaite's degrees of freedom err to the safe side.
    assert 0.95 - 3 * np.sqrt(0.95 * 0.05 / 1200) < np.mean(covered) < 0.985


@pytest.mark.thorough
def test_the_variance_is_the_mean_square_of_the_error() -> None:
    robot = section_v_target()
    plan, reference, _ = a_test_on(robot, 3.0)
    z = closed_form(robot, np.array([3.0]))
    noisy = section_v_target(noise_std_m=0.02)
    errors, variances = [], []
    for _ in range(400):
        noisy.connect()
        measured = estimate_frequency_response(reference, noisy.run(reference[:, None])[:, 0], plan)
        errors.append(abs(measured.z[0] - z[0]) ** 2)
        variances.append(measured.noise_variance[0])
    assert np.mean(variances) == pytest.approx(np.mean(errors), rel=0.15)


@given(st.integers(3, 20), st.floats(0.001, 0.5))
def test_a_disc_is_a_quantile_of_the_f_distribution(segments: int, alpha: float) -> None:
    expected = np.sqrt(0.3 * f.isf(alpha, 2, 2 * segments - 2))
    radius = uncertainty_radius(np.array(0.3), np.array(2 * segments - 2), alpha)
    assert radius == pytest.approx(expected, rel=1e-9)


@settings(deadline=None, max_examples=40)
@given(st.floats(-100.0, 100.0), st.floats(-1.0, 1.0), st.floats(1e-6, 1e6))
def test_offset_drift_and_unit_change_nothing(offset: float, drift: float, unit: float) -> None:
    robot = section_v_target()
    plan, reference, response = a_test_on(robot, 2.0)
    moved = response + offset + drift * np.arange(len(response)) / len(response)
    measured = estimate_frequency_response(unit * reference, unit * moved, plan)
    expected = estimate_frequency_response(reference, response, plan)
    np.testing.assert_allclose(measured.z, expected.z, rtol=1e-8)
    assert measured.quality.usable


def test_what_follows_the_measuring_part_may_be_missing() -> None:
    plan, reference, response = a_test_on(section_v_target(), 2.0)
    whole = estimate_frequency_response(reference, response, plan)
    end = plan.samples - plan.ramp_samples
    np.testing.assert_array_equal(
        estimate_frequency_response(reference[:end], response[:end], plan).z, whole.z
    )


def test_the_least_segments_and_samples_are_enough() -> None:
    plan = ExcitationPlan(
        axis="x",
        tones=(Tone(omega_rad_s=40.0),),
        amplitude=1.0,
        sample_time_s=0.02,
        ramp_samples=8,
        settle_samples=0,
        segments=3,
        segment_samples=8,
    )
    reference = reference_of(plan)
    measured = estimate_frequency_response(reference, 0.5 * reference, plan)
    assert measured.z[0] == pytest.approx(0.5, abs=1e-12)
    assert measured.quality.usable
