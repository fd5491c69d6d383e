"""What still rings after the ramp of a test is found, measured and kept out of its estimate."""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.signal import cont2discrete, lfilter

from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test import ring_down as ring_down_module
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.multitone import multitone
from nufleet.shared.frequency_test.ring_down import _Record, _refined, ring_down
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

STEP_S = 0.02
HARMONICS = (1, 3, 5, 7, 9, 11)


class Resonant:
    """A second-order loop, discretised exactly for references that are held between samples."""

    def __init__(self, omega_rad_s: float, damping: float) -> None:
        w = omega_rad_s
        continuous = ([w**2], [1.0, 2 * damping * w, w**2])
        numerator, self._denominator, _ = cont2discrete(continuous, STEP_S, "zoh")
        self._numerator = numerator.ravel()
        self.decay_1_s = damping * w

    def play(self, reference: FloatArray) -> FloatArray:
        return np.asarray(lfilter(self._numerator, self._denominator, reference))

    def z(self, omega_rad_s: FloatArray) -> ComplexArray:
        step = np.exp(-1j * omega_rad_s * STEP_S)
        return np.asarray(
            np.polyval(self._numerator[::-1], step) / np.polyval(self._denominator[::-1], step)
        )


def played(
    robot: Resonant,
    settle_s: float,
    noise: float,
    seed: int,
    base_rad_s: float = 0.5,
    harmonics: Sequence[int] = HARMONICS,
    phases_rad: Sequence[float] | None = None,
) -> FrequencyResponse:
    spec = RobotSpec(
        kind="any",
        axes=(AxisSpec(name="x", unit="m", amplitude_max=1, velocity_max=2, acceleration_max=9),),
        sample_time_s=STEP_S,
        omega_min_rad_s=0.01,
        omega_max_rad_s=20.0,
        duration_max_s=600.0,
        settling_time_s=settle_s,
        simulated=False,
    )
    (tones,) = multitone(base_rad_s, [tuple(harmonics)], [np.ones(len(harmonics))])
    if phases_rad is not None:
        tones = tuple(
            Tone(omega_rad_s=tone.omega_rad_s, phase_rad=phase)
            for tone, phase in zip(tones, phases_rad, strict=True)
        )
    plan: ExcitationPlan = plan_excitation(
        Excitation(axis="x", tones=tones, segments=3), spec, "robot"
    )
    reference = reference_of(plan)
    rng = np.random.default_rng(seed)
    output = robot.play(reference) + noise * rng.standard_normal(plan.samples)
    return estimate_frequency_response(reference, output, plan)


@settings(max_examples=12, deadline=None)
@given(omega=st.floats(1.5, 4.0), damping=st.floats(0.04, 0.1), seed=st.integers(0, 1000))
@example(omega=1.5, damping=0.066, seed=3)
def test_a_settling_time_that_is_stated_ten_times_too_short_is_measured(
    omega: float, damping: float, seed: int
) -> None:
    robot = Resonant(omega, damping)
    settling_s = 3 / robot.decay_1_s
    # Twice as much noise hides the ring of the best damped of these robots.
    found_in = played(robot, 0.1 * settling_s, 0.0015, seed)
    found = {finding.code: finding.value for finding in found_in.quality.warnings}
    assert found["ringing"] == pytest.approx(settling_s, rel=0.25)
    for noise in (0.0015, 0.003):
        measured = played(robot, 0.1 * settling_s, noise, seed)
        assert measured.quality.usable, str(measured.quality)
        # Found or hidden, the estimates are as good as if the robot had settled.
        off = np.abs(measured.z - robot.z(measured.omega_rad_s))
        assert np.mean(off <= measured.radius(0.001)) > 0.8
        assert np.all(off < 0.02 * (1 + np.abs(measured.z) ** 2))


def test_a_robot_that_settled_is_not_said_to_ring() -> None:
    robot = Resonant(3.0, 0.2)
    ringing = [
        any(f.code == "ringing" for f in played(robot, 12.0, 0.003, seed).quality.warnings)
        for seed in range(20)
    ]
    assert not any(ringing)


@pytest.mark.parametrize("memory", [0.0, 0.95])
def test_noise_alone_hardly_ever_rings(memory: float) -> None:
    omega = 0.5 * np.array(HARMONICS)
    rung = 0
    for seed in range(60):
        drawn = np.random.default_rng(seed).standard_normal(1300)
        noise = lfilter([1.0], [1.0, -memory], drawn)[300:]
        rung += len(ring_down(noise, omega, 5.5, STEP_S, 300).decay_1_s) > 0
    assert rung <= 2


def test_a_decay_that_was_found_before_explains_nothing_more() -> None:
    """All of it lies along the basis, so that its energy is a rounding error of either sign."""
    times_s = STEP_S * np.arange(200)
    for seed in range(100):
        rng = np.random.default_rng(seed)
        decay = 10 ** rng.uniform(-0.5, 1.0)
        known = [np.ones(200), times_s, np.exp(-decay * times_s)]
        basis = np.linalg.qr(np.stack(known, axis=1))[0]
        left = rng.standard_normal(200)
        left -= basis @ (basis.T @ left)
        found = _refined(left, basis, times_s, (decay, 0.0))
        assert np.all(np.isfinite(found))


@pytest.mark.parametrize("seed", [87, 271, 349, 497, 584])
def test_a_search_that_wanders_off_ends_within_what_the_record_tells(seed: int) -> None:
    """What decays within a few samples can be placed at any faster decay as well."""
    rng = np.random.default_rng(seed)
    samples, step_s = int(rng.integers(60, 300)), 10 ** rng.uniform(-3, 0)
    times_s = step_s * np.arange(samples)
    basis = np.linalg.qr(np.stack([np.ones(samples), times_s], axis=1))[0]
    left = rng.standard_normal(samples)
    left *= np.exp(-(10 ** rng.uniform(-4, 4)) * np.arange(samples))
    left -= basis @ (basis.T @ left)
    first, second = (10 ** rng.uniform(-3, 3, 2) / times_s[-1]).tolist()
    decay_1_s, omega_rad_s = _refined(left, basis, times_s, (first, second))
    assert 0.29 / times_s[-1] < decay_1_s < 1.01 / step_s
    assert np.isfinite(omega_rad_s)


def test_robots_that_settle_equally_long_share_the_columns_of_their_tones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    prepared: list[int] = []
    of = _Record.of

    def counting(*record: object) -> _Record:
        prepared.append(1)
        return of(*record)  # type: ignore[arg-type]

    shared = lru_cache(counting)
    monkeypatch.setattr(ring_down_module, "_kept_record", shared)
    rng = np.random.default_rng(1)
    for _ in range(20):
        ring_down(rng.standard_normal(500), np.array([0.7, 1.9]), 1.9, STEP_S, 100)
    assert len(prepared) == 1


class Shaken(Resonant):
    """A well-damped loop that also shakes two things, each at a frequency of its own."""

    def __init__(self, omega_rad_s: Sequence[float], damping: float, height: float) -> None:
        super().__init__(3.0, 0.8)
        self._shaken = [Resonant(omega, damping) for omega in omega_rad_s]
        self._share = 2 * damping * height

    def play(self, reference: FloatArray) -> FloatArray:
        moved = [one.play(reference) for one in self._shaken]
        return super().play(reference) + self._share * np.sum(moved, axis=0)

    def z(self, omega_rad_s: FloatArray) -> ComplexArray:
        moved = [one.z(omega_rad_s) for one in self._shaken]
        return super().z(omega_rad_s) + self._share * np.sum(moved, axis=0)


def test_two_narrow_resonances_near_tones_are_no_change_in_the_middle_of_the_test() -> None:
    rng = np.random.default_rng(1)
    # With random phases, one such test in twenty is repeated.
    phases_rad = [0.376, 5.255, 4.923, 4.05, 2.694, 1.17, 4.853, 2.489, 0.343]
    phases_rad += [3.429, 5.445, 2.165, 4.442, 5.264, 1.255, 2.419, 2.578, 3.366]
    off, stated = [], []
    for seed in range(12):
        robot = Shaken(rng.uniform(1.0, 5.0, 2), 0.045, 0.4)
        settle_s = 1.4 / (0.045 * 3.0)
        measured = played(robot, settle_s, 0.003, seed, 0.15, range(1, 36, 2), phases_rad)
        assert measured.quality.usable, str(measured.quality)
        off.append(np.abs(measured.z - robot.z(measured.omega_rad_s)))
        stated.append(np.sqrt(measured.variance))
    assert np.mean(np.array(off) > 2.5 * np.array(stated)) < 0.06
