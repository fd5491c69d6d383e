"""Random fleets for experience selection: every test is played and estimated from its samples."""

from __future__ import annotations

import math
from collections.abc import Mapping
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
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

NOISE_LEVELS_M = {"low": 0.003, "high": 0.012}
"""Standard deviation of the white noise on each sample of the position, at 50 Hz."""

TRUTH_POINTS = 4001


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
        self._noise_m = noise_m
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
        noisy = clean + self._noise_m * self._rng.standard_normal(len(reference))
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

    The true response of a nonlinear robot is the one to single tones of the amplitude that the
    robot itself chooses for them, without noise.
    """
    family = FAMILIES[name]
    band = family.band_rad_s
    robots = [TestedRobot(family.draw(rng), noise_m, rng, family) for _ in range(sources + 1)]
    if isinstance(robots[0].loop, NonlinearLoop):
        omega = np.geomspace(*band, 40)
    else:
        omega = np.linspace(*band, TRUTH_POINTS)
    z = [true_response(robot, omega) for robot in robots]
    named = {f"source-{n}": robot for n, robot in enumerate(robots[1:], start=1)}
    distances = [float(chordal_distance(z[0], other).max()) for other in z[1:]]
    return Fleet(robots[0], named, dict(zip(named, distances, strict=True)), band)


def true_response(robot: TestedRobot, omega_rad_s: FloatArray) -> ComplexArray:
    """Return z without noise; of a nonlinear robot as `random_fleet` says."""
    if isinstance(robot.loop, LinearLoop):
        return robot.loop.response(omega_rad_s)
    return np.array([_to_one_tone(robot, omega) for omega in omega_rad_s.tolist()])


def _to_one_tone(robot: TestedRobot, omega_rad_s: float) -> complex:
    """Return the fundamental of a nonlinear robot's response over that of the reference."""
    single = Excitation(axis="x", tones=(Tone(omega_rad_s=omega_rad_s),), segments=3)
    plan = plan_excitation(single, robot.spec, "robot")
    reference = reference_of(plan)
    response = robot.moved(reference)
    first = plan.first_measured_sample
    measured = slice(first, first + plan.segments * plan.segment_samples)
    phase = omega_rad_s * np.arange(plan.samples)[measured] * plan.sample_time_s
    columns = np.stack([np.cos(phase), np.sin(phase), np.ones(len(phase))], axis=1)
    both = np.stack([reference[measured], response[measured]], axis=1)
    cosine, sine, _ = np.linalg.lstsq(columns, both, rcond=None)[0]
    u, y = cosine - 1j * sine
    return complex(y / u)


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
