"""What outlasts a test, and looks like one of its tones, makes that tone uncertain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.signal import lfilter

from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.tone_choice import first_look, lowest_look_together
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response
from nufleet.shared.frequency_test.hidden_transient import (
    EXPECTED,
    SIZES,
    _Grid,
    hidden_transient,
    may_ring,
)
from nufleet.shared.frequency_test.sinusoid_fit import fit_sinusoids
from nufleet.sims.coupled_loops import CoupledLoops, CoupledLoopsSettings
from tests.shared.frequency_test.test_ring_down import HARMONICS, STEP_S, Resonant, played

OMEGA = 0.5 * np.array(HARMONICS)
SAMPLES, SETTLE = 780, 144
NOISE = 0.01


class Shaken(Resonant):
    """A well-damped loop that also shakes something, which takes minutes to come to rest."""

    def __init__(self, omega_rad_s: float, damping: float, height: float) -> None:
        super().__init__(3.0, 0.7)
        self._slow = Resonant(omega_rad_s, damping)
        self._share = 2 * damping * height

    def play(self, reference: FloatArray) -> FloatArray:
        return super().play(reference) + self._share * self._slow.play(reference)

    def z(self, omega_rad_s: FloatArray) -> FloatArray:
        return super().z(omega_rad_s) + self._share * self._slow.z(omega_rad_s)


def tones(rng: np.random.Generator) -> FloatArray:
    phases = rng.uniform(0, 2 * np.pi, len(OMEGA))
    return np.cos(np.outer(STEP_S * np.arange(SAMPLES), OMEGA) + phases).sum(axis=1)


LOW_PEAK_RAD = (6.27, 5.245, 3.153, 6.273, 2.092, 3.149)
"""Phases of the tones with which their sum has the lowest peak."""


def errors_at_the_lowest_tone(
    settle_s: float, phases_rad: Sequence[float] | None = None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return how far it is off in tests of robots with a slow resonance below the tones.

    Args:
        settle_s: Time within which the robots settle as if they had no resonance.
        phases_rad: Phases of the tones; None draws them for each robot.

    Returns:
        The errors, their standard deviations as stated, and those without hidden transients, each
        of shape (robots,).
    """
    rng = np.random.default_rng(1)
    off, stated, without = [], [], []
    for seed in range(60):
        robot = Shaken(rng.uniform(0.3, 0.5), rng.uniform(0.05, 0.15), rng.uniform(0.2, 0.5))
        drawn = phases_rad or rng.uniform(0, 2 * np.pi, len(HARMONICS)).tolist()
        measured = played(robot, settle_s, 0.003, seed, phases_rad=drawn)
        off.append(abs(measured.z - robot.z(measured.omega_rad_s))[0])
        stated.append(np.sqrt(measured.variance[0]))
        without.append(np.sqrt(measured.noise_variance[0]))
    return np.array(off), np.array(stated), np.array(without)


def test_a_slow_resonance_below_the_tones_makes_the_lowest_of_them_uncertain() -> None:
    off, stated, without = errors_at_the_lowest_tone(2.0, LOW_PEAK_RAD)
    far = 2.5
    assert np.mean(off > far * without) > 0.8
    assert np.mean(off > far * stated) < 0.4
    assert np.sqrt(np.mean(np.square(stated))) > 0.5 * np.sqrt(np.mean(np.square(off)))


def test_with_random_phases_it_is_too_little_uncertain_for_half_of_the_robots() -> None:
    off, stated, without = errors_at_the_lowest_tone(4.0)
    assert np.mean(off > 2.5 * without) > 0.9
    assert np.mean(off > 2.5 * stated) < 0.65
    assert np.sqrt(np.mean(np.square(stated))) > 0.6 * np.sqrt(np.mean(np.square(off)))


def test_the_variance_is_the_mean_square_by_which_transients_as_expected_move_the_tones() -> None:
    rng = np.random.default_rng(2)
    block = 3
    step_s = block * STEP_S
    grid = _Grid.of(tuple(OMEGA.tolist()), len(OMEGA), step_s, SAMPLES // block, SETTLE // block)
    times_s = STEP_S * np.arange(SAMPLES)
    prior = np.exp(grid.log_prior[: grid.ringing])
    off, stated = [], []
    for _ in range(400):
        steady = tones(rng)
        part = rng.choice(grid.ringing, p=prior / prior.sum())
        turning = np.exp((1j * grid.omega_rad_s[part] - grid.decay_1_s[part]) * times_s)
        size = rng.choice(SIZES) * float(np.std(steady)) * (rng.random() < EXPECTED)
        drawn = size * rng.standard_normal(2)
        output = steady + drawn[0] * turning.real + drawn[1] * turning.imag
        noisy = output + NOISE * rng.standard_normal(SAMPLES)
        found = hidden_transient(noisy, OMEGA, len(OMEGA), STEP_S, SETTLE, SETTLE * STEP_S)
        assert found is not None
        fits = fit_sinusoids([steady[SETTLE:], noisy[SETTLE:]], OMEGA, STEP_S, 3)
        off.append(np.abs(fits[1].phasors - fits[0].phasors) ** 2)
        stated.append(found.variance + 4 * NOISE**2 / (SAMPLES - SETTLE))
    ratio = np.mean(stated, axis=0) / np.mean(off, axis=0)
    # A few large transients dominate both means.
    assert np.all((ratio > 0.6) & (ratio < 1.7)), ratio


@pytest.mark.parametrize("seconds", [15, 100])
def test_what_hardly_decays_within_the_record_is_no_surprise_at_any_frequency_and_size(
    seconds: int,
) -> None:
    rng = np.random.default_rng(6)
    samples = round(seconds / STEP_S)
    settle, omegas = samples // 5, OMEGA * 15 / seconds
    omegas = np.concatenate([omegas, np.linspace(1.2 * omegas[-1], OMEGA[-1], seconds // 10)])
    times_s = STEP_S * np.arange(samples)
    far = []
    for _ in range(150):
        phases = rng.uniform(0, 2 * np.pi, len(omegas))
        steady = np.cos(np.outer(times_s, omegas) + phases).sum(axis=1)
        rate = complex(-rng.uniform(0.3, 1.5), rng.uniform(0.0, 22.0)) / seconds
        rings = rng.uniform(0.05, 1.0) * np.exp(rate * times_s + 1j * rng.uniform(0, 2 * np.pi))
        output = steady + rings.real + NOISE * rng.standard_normal(samples)
        found = hidden_transient(output, omegas, len(omegas), STEP_S, settle, settle * STEP_S)
        assert found is not None
        fits = fit_sinusoids([steady[settle:], output[settle:]], omegas, STEP_S, 3)
        off = np.abs(fits[1].phasors - fits[0].phasors)
        far.append(off > 2.5 * np.sqrt(found.variance + 4 * NOISE**2 / (samples - settle)))
    assert np.mean(far) < 0.03


def test_noise_of_a_settled_robot_says_that_hardly_anything_rings() -> None:
    rng = np.random.default_rng(3)
    found = [
        hidden_transient(
            tones(rng) + NOISE * rng.standard_normal(SAMPLES),
            OMEGA,
            len(OMEGA),
            STEP_S,
            SETTLE,
            SETTLE * STEP_S,
        )
        for _ in range(60)
    ]
    assert all(one is not None and one.probability < 0.5 for one in found)
    assert all(may_ring(one, 3.0) is None for one in found)


def test_gusts_are_no_transient() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        blown = lfilter([1.0], [1.0, -0.98], rng.standard_normal(SAMPLES + 500))[500:]
        output = tones(rng) + 0.3 * blown / float(np.std(blown))
        output += NOISE * rng.standard_normal(SAMPLES)
        assert hidden_transient(output, OMEGA, len(OMEGA), STEP_S, SETTLE, SETTLE * STEP_S) is None


def test_a_transient_that_outlasts_the_test_is_a_finding_with_its_settling_time() -> None:
    rng = np.random.default_rng(5)
    times_s = STEP_S * np.arange(SAMPLES)
    for decay in (0.03, 0.06, 0.12):
        settling_s = []
        for _ in range(20):
            ringing = 0.5 * np.exp(-decay * times_s) * np.cos(0.3 * times_s + rng.uniform(0, 6))
            output = tones(rng) + ringing + NOISE * rng.standard_normal(SAMPLES)
            found = may_ring(
                hidden_transient(output, OMEGA, len(OMEGA), STEP_S, SETTLE, SETTLE * STEP_S), 3.0
            )
            assert found is not None
            settling_s.append(found.value)
        # What is slower than the record is long is told to a factor.
        assert 1 / 3 < float(np.median(settling_s)) * decay / 3 < 3.0


def test_distortion_between_the_tones_does_not_decay_and_is_no_transient() -> None:
    rng = np.random.default_rng(8)
    found = []
    for power in (2, 3) * 20:
        steady = tones(rng)
        bent = steady**power - np.mean(steady**power)
        output = steady + 0.02 * rng.uniform(0.3, 3.0) * bent / float(np.std(bent))
        output += NOISE * rng.standard_normal(SAMPLES)
        hidden = hidden_transient(output, OMEGA, len(OMEGA), STEP_S, SETTLE, SETTLE * STEP_S)
        found.append(may_ring(hidden, 3.0))
    assert sum(one is not None for one in found) <= 1


def test_what_rings_alone_at_the_frequency_of_distortion_is_a_transient() -> None:
    rng = np.random.default_rng(9)
    times_s = STEP_S * np.arange(SAMPLES)
    found = []
    for harmonic in (2, 4, 6, 8) * 10:
        omega_rad_s = 0.5 * harmonic * rng.uniform(0.97, 0.99)
        ringing = 0.1 * np.exp(-0.03 * times_s) * np.cos(omega_rad_s * times_s + rng.uniform(0, 6))
        output = tones(rng) + ringing + NOISE * rng.standard_normal(SAMPLES)
        hidden = hidden_transient(output, OMEGA, len(OMEGA), STEP_S, SETTLE, SETTLE * STEP_S)
        assert hidden is not None
        found.append(may_ring(hidden, 3.0))
    assert np.mean([one is not None for one in found]) > 0.9


def test_what_decays_at_once_is_not_taken_for_something_slower() -> None:
    rng = np.random.default_rng(7)
    times_s = STEP_S * np.arange(SAMPLES)
    for _ in range(20):
        decay = rng.uniform(30.0, 60.0) / times_s[-1]
        ringing = np.exp(-decay * times_s) * np.cos(0.3 * times_s + rng.uniform(0, 6))
        output = tones(rng) + ringing + NOISE * rng.standard_normal(SAMPLES)
        found = hidden_transient(output, OMEGA, len(OMEGA), STEP_S, SETTLE, SETTLE * STEP_S)
        assert may_ring(found, 1.2 * 3 / decay) is None


def test_what_rings_amid_the_distortion_of_several_axes_is_still_found() -> None:
    own, others = 0.5 * np.array([1, 9, 17]), 0.5 * np.array([5, 11, 19])
    times_s = STEP_S * np.arange(SAMPLES)
    period = round(2 * np.pi / 0.5 / STEP_S)
    found = []
    for seed in range(20):
        rng = np.random.default_rng(seed)
        one, other = (
            np.cos(np.outer(times_s, omega) + rng.uniform(0, 6, 3)) @ omega**-0.5
            for omega in (own, others)
        )
        output = one + 0.02 * other**2 + 0.02 * one * other
        output += 0.2 * np.exp(-0.3 * times_s) * np.cos(1.3 * times_s + seed)
        output += 0.02 * rng.standard_normal(SAMPLES)
        omega = np.concatenate([own, others])
        hidden = hidden_transient(output, omega, 6, STEP_S, SETTLE, SETTLE * STEP_S, period=period)
        found.append(may_ring(hidden, SETTLE * STEP_S) is not None)
    assert np.mean(found) > 0.9


def test_distortion_of_several_axes_is_no_reason_to_wait() -> None:
    settings = AdaptiveSettings()
    slower = {"first": 0, "lowest": 0}
    for seed in range(24):
        rng = np.random.default_rng(seed)
        robot = CoupledLoops(
            "robot",
            CoupledLoopsSettings(
                natural_frequency_rad_s=tuple(rng.uniform(2.5, 5.0, 3).tolist()),
                damping_ratio=tuple(rng.uniform(0.5, 0.9, 3).tolist()),
                coupling=tuple(rng.uniform(-0.2, 0.2, 3).tolist()),
                axes=("x", "y", "z"),
                noise_std_m=0.002,
            ),
            rng,
        )
        robot.connect()
        periods, share = settings.first_periods, settings.share_of_settling
        first = first_look((0.2, 8.0), robot.spec, periods, share, (0, 1, 2))
        lowest = lowest_look_together((0.2, 8.0), robot.spec, 0.5, (0, 1, 2), 1)
        assert lowest is not None
        for name, look in (("first", first), ("lowest", lowest)):
            settle_s = settings.settle_share * robot.spec.settling_time_s
            test = look.excitation("x", "y", "z", settle_s=settle_s)
            plan = plan_excitation(test, robot.spec, "robot")
            reference = reference_of(plan)
            moved = robot.run(reference)
            robot.rest()
            moved = moved + 0.3 * np.roll(moved, 1, axis=1) ** 2
            found = estimate_frequency_response(reference, moved, plan).quality.warnings
            values = [one.value or 0.0 for one in found if one.code == "ringing"]
            slower[name] += any(value > 1.2 * robot.spec.settling_time_s for value in values)
    assert max(slower.values()) <= 2


@pytest.mark.parametrize("settle", [0, 1, 5, 40, 100])
def test_a_short_time_to_settle_does_not_hide_what_rings(settle: int) -> None:
    """With hardly more than a period, what repeats says nothing."""
    period = round(2 * np.pi / 0.5 / STEP_S)
    omega = 0.5 * np.array([1, 5, 9, 11, 17, 19])
    times_s = STEP_S * np.arange(period + settle)
    output = np.cos(np.outer(times_s, omega) + np.arange(6)).sum(axis=1)
    output += 0.05 * np.cos(3 * times_s) * np.cos(times_s)
    output += 0.6 * np.exp(-0.25 * times_s) * np.cos(1.3 * times_s)
    output += 0.03 * np.random.default_rng(0).standard_normal(len(times_s))
    waited_s = settle * STEP_S
    hidden = hidden_transient(output, omega, 6, STEP_S, settle, waited_s, period=period)
    found = may_ring(hidden, waited_s)
    assert found is not None
    assert ("at least" in found.text) == (settle > 30), found.text
    assert found.value is not None
    assert 4.0 < found.value < 16.0
