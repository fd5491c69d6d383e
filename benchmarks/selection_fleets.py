"""Random fleets for experience selection: every test is played and estimated from its samples."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.fft import next_fast_len

from benchmarks.nonlinear_loop import NonlinearLoop, play
from benchmarks.selection_families import (
    FAMILIES,
    SAMPLE_TIME_S,
    SETTLED,
    Family,
    LinearLoop,
    Loop,
)
from nufleet.orchestrator.conduct.attempts import ATTEMPTS, retried
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.tone_choice import WEIGHT_EXPONENT, first_look
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

NOISE_LEVELS_M = {"low": 0.003, "high": 0.012}
"""Standard deviation of the white noise on each sample of the position, at 50 Hz."""

RUNAWAY_GAIN = 100.0
"""Gain from which on a robot ran away."""

TRUTH_POINTS = 4001
TRUTH_HARMONIC = 54
TRUTH_MOTIONS = 4
"""Number of frequencies at which the response of linear loops is computed, and of the tones and the
motions from which that of others is.
"""


class TestedRobot:
    """A robot of a random fleet: its spec, its true response and what a test of it gives."""

    __test__ = False  # pytest: not a test case

    def __init__(
        self, loop: Loop, noise_m: float, rng: np.random.Generator, family: Family | None = None
    ) -> None:
        family = family or Family(lambda _: loop)
        self.loop = loop
        settling_time_s = -math.log(SETTLED) / loop.slowest_decay_1_s
        self.spec = spec_of(family.stated(rng, settling_time_s), family.sample_time_s)
        self.noise_m = noise_m
        self._spoil = family.spoil
        self._rng = rng

    def test(self, excitation: Excitation) -> tuple[FrequencyResponse, float]:
        """Return the estimated response and the robot-seconds it took, all attempts included."""
        flown_s = 0.0
        for _ in range(ATTEMPTS):
            plan = plan_excitation(excitation, self.spec, "robot")
            flown_s += plan.duration_s
            reference = reference_of(plan)
            response = estimate_frequency_response(reference, self.fly(reference), plan)
            if response.quality.usable:
                break
            excitation = retried(excitation, plan, response.quality, self.spec)
        return response, flown_s

    def fly(self, reference: FloatArray) -> FloatArray:
        """Return the output for any reference, shape (samples,), from rest at its first sample."""
        clean = self.moved(reference)
        noisy = clean + self.noise_m * self._rng.standard_normal(len(reference))
        return noisy if self._spoil is None else self._spoil(self._rng, noisy)

    def moved(self, reference: FloatArray) -> FloatArray:
        """Return the position itself, without noise."""
        step_s = self.spec.sample_time_s
        if isinstance(self.loop, NonlinearLoop):
            return play(self.loop, reference - reference[0], step_s) + reference[0]
        return _played(self.loop, reference, step_s)


@dataclass(frozen=True)
class Fleet:
    """A target and sources, with each source's true worst-case distance over the band."""

    target: TestedRobot
    sources: Mapping[str, TestedRobot]
    psi_star: Mapping[str, float]
    band_rad_s: tuple[float, float]
    omega_rad_s: FloatArray
    """Frequencies of the true responses in rad/s, shape (frequencies,)."""
    z: Mapping[str, ComplexArray]
    """True response of each robot at these frequencies, by name; the target is called so."""

    @property
    def robots(self) -> dict[str, TestedRobot]:
        """All robots by name; the target is called so."""
        return {"target": self.target, **self.sources}

    def regret(self, selected: str | None) -> float:
        """Return how much further the source selected is than the closest; 1 where none was."""
        if selected is None:
            return 1.0
        return self.psi_star[selected] - min(self.psi_star.values())


def spec_of(settling_time_s: float, sample_time_s: float = SAMPLE_TIME_S) -> RobotSpec:
    """Return limits like those of a small quadrotor."""
    return RobotSpec(
        kind="random-loop",
        axes=(
            AxisSpec(name="x", unit="m", amplitude_max=0.5, velocity_max=1.0, acceleration_max=4.0),
        ),
        sample_time_s=sample_time_s,
        omega_min_rad_s=0.05,
        omega_max_rad_s=20.0,
        duration_max_s=1800.0,
        settling_time_s=settling_time_s,
        simulated=False,
    )


def random_fleet(name: str, sources: int, noise_m: float, rng: np.random.Generator) -> Fleet:
    """Draw a target and sources of one family.

    The true response of a nonlinear robot is the one to many tones at once, over the whole band and
    at the amplitude at which a study tests it: that of its linear approximation in such motions.
    There is none of a robot that runs away in them, as one with a slow actuator may: another robot
    is drawn instead.
    """
    family = FAMILIES[name]
    band = family.band_rad_s
    robots = [TestedRobot(family.draw(rng), noise_m, rng, family) for _ in range(sources + 1)]
    omega, z = true_responses(robots, band)
    for n in range(len(robots)):
        while not np.abs(z[n]).max() < RUNAWAY_GAIN:  # not a number of one that overflows, either
            robots[n] = TestedRobot(family.draw(rng), noise_m, rng, family)
            z[n] = true_responses([robots[n]], band)[1][0]
    named = {f"source-{n}": robot for n, robot in enumerate(robots[1:], start=1)}
    responses = dict(zip(("target", *named), z, strict=True))
    psi_star = {
        name: float(chordal_distance(responses["target"], responses[name]).max()) for name in named
    }
    return Fleet(robots[0], named, psi_star, band, omega, responses)


def true_responses(
    robots: Sequence[TestedRobot], band_rad_s: tuple[float, float]
) -> tuple[FloatArray, ComplexArray]:
    """Return frequencies in rad/s and z without noise there, shape (robots, frequencies)."""
    omega = np.linspace(*band_rad_s, TRUTH_POINTS)
    loops = [robot.loop for robot in robots]
    linear = [loop.response(omega) for loop in loops if isinstance(loop, LinearLoop)]
    if len(linear) == len(loops):
        return omega, np.array(linear)
    base = band_rad_s[1] / TRUTH_HARMONIC
    tones = range(math.ceil(band_rad_s[0] / base), TRUTH_HARMONIC + 1)
    return base * np.array(tones), np.array(
        [np.mean(list(_linearised(robot, band_rad_s, base, tones)), axis=0) for robot in robots]
    )


def _linearised(
    robot: TestedRobot, band_rad_s: tuple[float, float], base_rad_s: float, tones: range
) -> Iterator[ComplexArray]:
    """Yield the response to as many tones of random phases as large as a study's first test."""
    settings = AdaptiveSettings()
    first = first_look(band_rad_s, robot.spec, settings.first_periods, settings.share_of_settling)
    played = reference_of(plan_excitation(first.excitation("x"), robot.spec, "robot"))
    step_s = robot.spec.sample_time_s
    period = round(2 * math.pi / (base_rad_s * step_s))
    omega = base_rad_s * np.array(tones)
    times_s = step_s * np.arange(3 * period)
    for seed in range(TRUTH_MOTIONS):
        phases = np.random.default_rng(seed).uniform(0, 2 * math.pi, len(omega))
        reference = np.cos(np.outer(times_s, omega) + phases) @ omega**WEIGHT_EXPONENT
        reference *= float(np.std(played)) / float(np.std(reference))
        output = robot.moved(reference)
        # Three periods, of which the last is taken, when everything has settled.
        late = np.exp(-1j * np.outer(omega, times_s[-period:]))
        yield (late @ output[-period:]) / (late @ reference[-period:])


def _played(loop: LinearLoop, reference: FloatArray, sample_time_s: float) -> FloatArray:
    """Return a linear loop's output, through the spectrum of its reference's differences.

    They are padded until all that follows has settled, so that the transform's periodicity does no
    harm.
    """
    settled_s = -math.log(SETTLED**2) / loop.slowest_decay_1_s
    samples = next_fast_len(len(reference) + math.ceil(settled_s / sample_time_s), real=True)
    steps = np.zeros(samples)
    steps[1 : len(reference)] = np.diff(reference)
    omega = 2 * np.pi * np.fft.rfftfreq(samples, sample_time_s)
    moved = np.fft.irfft(np.fft.rfft(steps) * loop.response(omega), samples)
    at_rest = float(loop.response(np.zeros(1))[0].real) * reference[0]
    return np.asarray(at_rest + np.cumsum(moved)[: len(reference)])
