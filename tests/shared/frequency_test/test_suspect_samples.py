"""A faulty sensor never moves an estimate that is used by more than the estimate says of itself."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings, closed_loop
from nufleet.sims.faults import FaultBase, Frozen, Held, Late, NotANumber, Saturated, Spikes
from nufleet.sims.faulty_robot import FaultyRobot

TONES = ((3.0,), (0.5, 1.0, 2.0, 4.0, 8.0))
SEEDS = range(12)
tones = pytest.mark.parametrize("omegas_rad_s", TONES)
noise_levels = pytest.mark.parametrize("noise_std_m", [0.0, 0.005])


@cache
def a_test(omegas_rad_s: tuple[float, ...]) -> tuple[ExcitationPlan, FloatArray, ComplexArray]:
    """Plan and reference of a test of the target of Section V, and its true response."""
    spec = target(0.0, 0).spec
    excitation = Excitation(
        axis="x",
        tones=tuple(
            Tone(omega_rad_s=omega, phase_rad=np.pi * k**2 / len(omegas_rad_s))
            for k, omega in enumerate(omegas_rad_s)
        ),
        segment_min_s=2 * np.pi / min(omegas_rad_s),
    )
    plan = plan_excitation(excitation, spec, "target")
    truth = closed_loop(settings(0.0)).frequency_response(np.array(omegas_rad_s))
    return plan, reference_of(plan), truth


def settings(noise_std_m: float) -> DoubleIntegratorSettings:
    return DoubleIntegratorSettings(alpha=0.85, beta=0.003, noise_std_m=noise_std_m)


def target(noise_std_m: float, seed: int) -> DoubleIntegrator:
    return DoubleIntegrator(settings(noise_std_m), np.random.default_rng(seed))


def measured(
    fault: FaultBase, omegas_rad_s: tuple[float, ...], noise_std_m: float, seed: int
) -> FrequencyResponse:
    plan, reference, _ = a_test(omegas_rad_s)
    robot = FaultyRobot(target(noise_std_m, seed), (fault,), np.random.default_rng([seed, 1]))  # type: ignore[arg-type]
    robot.connect()
    response = robot.run(reference[:, np.newaxis])[:, 0]
    return estimate_frequency_response(reference, response, plan)


@dataclass
class Seen:
    """What became of a fault over all seeds."""

    usable: int = 0
    misses: list[float] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    codes: Counter[str] = field(default_factory=Counter)


def over_all_seeds(
    fault: FaultBase, omegas_rad_s: tuple[float, ...], noise_std_m: float = 0.0
) -> Seen:
    seen = Seen()
    truth = a_test(omegas_rad_s)[2]
    for seed in SEEDS:
        estimate = measured(fault, omegas_rad_s, noise_std_m, seed)
        quality = estimate.quality
        seen.codes.update({f.code for f in (*quality.reasons, *quality.warnings)})
        if quality.usable:
            seen.usable += 1
            off = np.abs(estimate.z - truth) > estimate.radius(0.05)
            seen.misses.append(float(np.mean(off)))
            seen.errors.append(float(np.max(chordal_distance(estimate.z, truth))))
    return seen


def assert_honest(seen: Seen) -> None:
    """What was accepted holds the truth, to the five per cent of misses that it announces."""
    if seen.usable:
        assert np.mean(seen.misses) <= 0.15 or np.median(seen.errors) < 1e-3


@tones
@noise_levels
@pytest.mark.parametrize("probability", [0.01, 0.1, 0.3])
@pytest.mark.parametrize("level", [0.0, 0.8])
def test_samples_that_read_one_level_instead(
    omegas_rad_s: tuple[float, ...], noise_std_m: float, probability: float, level: float
) -> None:
    fault = Spikes(kind="spikes", probability=probability, height=level, replace=True)
    seen = over_all_seeds(fault, omegas_rad_s, noise_std_m)
    assert_honest(seen)
    assert seen.codes["spikes"] + seen.codes["too-many-spikes"] + seen.codes["clipped"] >= 11
    if probability == 0.3:
        assert seen.usable == 0


@tones
@noise_levels
@pytest.mark.parametrize(("probability", "run"), [(0.01, 5), (0.1, 1), (0.3, 1), (0.1, 5)])
def test_samples_that_are_lost_and_repeat_the_one_before(
    omegas_rad_s: tuple[float, ...], noise_std_m: float, probability: float, run: int
) -> None:
    fault = Held(kind="held", probability=probability, run=run)
    seen = over_all_seeds(fault, omegas_rad_s, noise_std_m)
    assert_honest(seen)
    if run == 1:
        assert seen.usable >= 9
    assert seen.codes["held-samples"] == len(SEEDS)


@tones
@noise_levels
@pytest.mark.parametrize("late_max", [1, 2, 8])
def test_samples_that_are_late_by_varying_amounts(
    omegas_rad_s: tuple[float, ...], noise_std_m: float, late_max: int
) -> None:
    fault = Late(kind="late", late_max=late_max)
    seen = over_all_seeds(fault, omegas_rad_s, noise_std_m)
    assert_honest(seen)
    # A delay that grows by one sample repeats one, too.
    assert seen.codes["late-samples"] + seen.codes["held-samples"] >= len(SEEDS)


@tones
@noise_levels
@pytest.mark.parametrize("bound_m", [0.95, 0.9, 0.6])
def test_a_range_that_ends_just_below_the_peaks(
    omegas_rad_s: tuple[float, ...], noise_std_m: float, bound_m: float
) -> None:
    plan, reference, _ = a_test(omegas_rad_s)
    quiet = target(0.0, 0)
    quiet.connect()
    first, end = plan.first_measured_sample, plan.samples - plan.ramp_samples
    peak = float(np.max(np.abs(quiet.run(reference[:, np.newaxis])[first:end])))
    fault = Saturated(kind="saturated", low=-bound_m * peak, high=bound_m * peak)
    seen = over_all_seeds(fault, omegas_rad_s, noise_std_m)
    assert_honest(seen)
    assert seen.usable == 0
    assert seen.codes["clipped"] == len(SEEDS)


@tones
@noise_levels
def test_a_response_that_becomes_another_in_the_middle(
    omegas_rad_s: tuple[float, ...], noise_std_m: float
) -> None:
    plan = a_test(omegas_rad_s)[0]
    for share in (0.2, 0.3, 0.7):
        begins = plan.first_measured_sample + round(share * plan.segments * plan.segment_samples)
        fault = Late(kind="late", late_min=3, late_max=3, from_sample=begins)
        seen = over_all_seeds(fault, omegas_rad_s, noise_std_m)
        assert seen.usable == 0
        assert seen.codes["changed"] + seen.codes["unsettled"] == len(SEEDS)


@pytest.mark.parametrize("noise_std_m", [0.02, 0.05])
def test_a_tracker_that_loses_sight_for_some_tenths_of_a_second_is_used_honestly(
    noise_std_m: float,
) -> None:
    seen = Seen()
    for begins in range(50, 500, 75):
        first = a_test(TONES[1])[0].first_measured_sample
        fault = Frozen(kind="frozen", from_sample=first + begins, samples=12)
        one = over_all_seeds(fault, TONES[1], noise_std_m)
        assert one.codes["held-samples"] == len(SEEDS)
        seen.usable += one.usable
        seen.misses += one.misses
        seen.errors += one.errors
    assert seen.usable >= 0.8 * 6 * len(SEEDS)
    assert_honest(seen)


@tones
def test_a_sensor_that_trembles_where_it_is_stuck(omegas_rad_s: tuple[float, ...]) -> None:
    first = a_test(omegas_rad_s)[0].first_measured_sample
    for samples in (10, 100):
        fault = Frozen(kind="frozen", from_sample=first + 50, samples=samples, noise=0.002)
        assert_honest(over_all_seeds(fault, omegas_rad_s))


def test_nothing_that_is_not_finite_is_ever_used() -> None:
    for omegas_rad_s in TONES:
        first = a_test(omegas_rad_s)[0].first_measured_sample
        fault = NotANumber(kind="not-a-number", from_sample=first + 5, samples=1)
        seen = over_all_seeds(fault, omegas_rad_s)
        assert seen.usable == 0
        assert set(seen.codes) == {"not-finite"}


@tones
@pytest.mark.parametrize("memory", [0.0, 0.9, 0.99])
def test_a_healthy_sensor_is_not_suspected(omegas_rad_s: tuple[float, ...], memory: float) -> None:
    plan, reference, _ = a_test(omegas_rad_s)
    quiet = target(0.0, 0)
    quiet.connect()
    response = quiet.run(reference[:, np.newaxis])[:, 0]
    found = Counter[str]()
    for seed in range(60):
        drawn = np.random.default_rng(seed).standard_normal(len(response) + 500)
        coloured = lfilter([1.0], [1.0, -memory], drawn)[500:]
        noisy = response + 0.02 * coloured / np.std(coloured)
        quality = estimate_frequency_response(reference, noisy, plan).quality
        found.update(f.code for f in (*quality.reasons, *quality.warnings))
    suspected = {"changed", "clipped", "held-samples", "late-samples", "spikes", "too-many-spikes"}
    assert sum(found[code] for code in suspected) <= 1


def test_a_constant_delay_is_part_of_the_robot_as_it_is_measured() -> None:
    """It cannot be told from slower dynamics, so nothing may be made of it."""
    omega_rad_s = 3.0
    estimate = measured(Late(kind="late", late_min=3, late_max=3), (omega_rad_s,), 0.0, 0)
    assert estimate.quality.usable
    turned = a_test((omega_rad_s,))[2] * np.exp(-1j * omega_rad_s * 3 * settings(0.0).sample_time_s)
    assert estimate.z == pytest.approx(turned, abs=1e-6)
