"""Random fleets for experience selection: six families of loops, each robot testable in no time.

A linear robot's test is not simulated sample by sample: its estimates ẑ are drawn from the error
that least squares has with white noise on the output, E|ẑ − z|² = 4σ²/(N A²) for a tone of
amplitude A in N samples, and their variances from the χ² distribution with two degrees of freedom
per segment and tone less one. `tests/benchmarks/test_selection_fleets.py` compares this with a
simulation.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.nonlinear_loop import NonlinearLoop, play
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.robots.spec import AxisSpec, RobotSpec

BAND_RAD_S = (0.1, 5.4)
SAMPLE_TIME_S = 0.02
NOISE_LEVELS_M = {"low": 0.003, "high": 0.012}
"""Standard deviation of the white noise on each sample of the position, at 50 Hz."""

SETTLED = 1e-3
"""A transient is negligible when the slowest mode has decayed to this share."""

TRUTH_POINTS = 4001


@dataclass(frozen=True)
class Mode:
    """A second-order mode with (1 + lead s) in its numerator, and its share of the response."""

    omega_rad_s: float
    damping: float
    lead_s: float = 0.0
    gain: float = 1.0


@dataclass(frozen=True)
class LinearLoop:
    """z(s) = e^{−delay s} Σ of modes."""

    modes: tuple[Mode, ...]
    delay_s: float

    def response(self, omega_rad_s: FloatArray) -> ComplexArray:
        """Return z at these frequencies."""
        s = 1j * np.asarray(omega_rad_s)
        total = np.zeros(s.shape, dtype=np.complex128)
        for mode in self.modes:
            x = s / mode.omega_rad_s
            total += mode.gain * (1 + mode.lead_s * s) / (1 + 2 * mode.damping * x + x**2)
        return np.asarray(total * np.exp(-self.delay_s * s))

    @property
    def slowest_decay_1_s(self) -> float:
        """The real part of the slowest pole, without its sign."""
        return min(_decay(mode) for mode in self.modes)


class TestedRobot:
    """A robot of a random fleet: its spec, its true response and what a test of it gives."""

    __test__ = False  # pytest: not a test case

    def __init__(
        self, loop: LinearLoop | NonlinearLoop, noise_m: float, rng: np.random.Generator
    ) -> None:
        self.loop = loop
        self.spec = spec_of(loop)
        self._noise_m = noise_m
        self._rng = rng

    def test(self, excitation: Excitation) -> tuple[FrequencyResponse, float]:
        """Return the estimated response and the robot-seconds it took."""
        plan = plan_excitation(excitation, self.spec, "robot")
        if isinstance(self.loop, NonlinearLoop):
            reference = reference_of(plan)
            clean = play(self.loop, reference, SAMPLE_TIME_S)
            noisy = clean + self._noise_m * self._rng.standard_normal(len(clean))
            return estimate_frequency_response(reference, noisy, plan), plan.duration_s
        return drawn_response(self.loop, plan, self._noise_m, self._rng), plan.duration_s


@dataclass(frozen=True)
class Fleet:
    """A target and sources, with each source's true worst-case distance over the band."""

    target: TestedRobot
    sources: Mapping[str, TestedRobot]
    psi_star: Mapping[str, float]

    @property
    def robots(self) -> dict[str, TestedRobot]:
        """All robots by name; the target is called so."""
        return {"target": self.target, **self.sources}

    def regret(self, selected: str | None) -> float:
        """Return how much further the source selected is than the closest; 1 where none was."""
        if selected is None:
            return 1.0
        return self.psi_star[selected] - min(self.psi_star.values())


def drawn_response(
    loop: LinearLoop, plan: ExcitationPlan, noise_m: float, rng: np.random.Generator
) -> FrequencyResponse:
    """Return a response with the errors that least squares has with white noise."""
    omega = np.array([tone.omega_rad_s for tone in plan.tones])
    samples = plan.segments * plan.segment_samples
    variance = 4 * noise_m**2 / (samples * tone_amplitudes(plan) ** 2)
    pairs = plan.segments - 1
    error = rng.standard_normal((2, len(omega))) * np.sqrt(variance / 2)
    return FrequencyResponse(
        omega_rad_s=omega,
        z=loop.response(omega) + error[0] + 1j * error[1],
        variance=variance * rng.chisquare(2 * pairs, len(omega)) / (2 * pairs),
        segments=plan.segments,
        quality=Quality(),
    )


def tone_amplitudes(plan: ExcitationPlan) -> FloatArray:
    """Return the amplitude of each tone of a plan's reference, in the axis's unit."""
    times_s = np.arange(plan.samples) * plan.sample_time_s
    weights = np.array([tone.weight for tone in plan.tones])
    phases = np.array([tone.phase_rad for tone in plan.tones])
    omega = np.array([tone.omega_rad_s for tone in plan.tones])
    total = weights @ np.sin(np.outer(omega, times_s) + phases[:, None])
    return plan.amplitude * weights / float(np.max(np.abs(total)))


def spec_of(loop: LinearLoop | NonlinearLoop) -> RobotSpec:
    """Return limits like a small quadrotor's, and the settling time of the loop's slowest pole."""
    return RobotSpec(
        kind="random-loop",
        axes=(
            AxisSpec(name="x", unit="m", amplitude_max=0.5, velocity_max=1.0, acceleration_max=4.0),
        ),
        sample_time_s=SAMPLE_TIME_S,
        omega_min_rad_s=0.05,
        omega_max_rad_s=20.0,
        duration_max_s=1800.0,
        settling_time_s=-math.log(SETTLED) / loop.slowest_decay_1_s,
        simulated=False,
    )


def second_order(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop with lead and delay."""
    omega, damping = rng.uniform(1.5, 5.0), rng.uniform(0.4, 1.0)
    lead_s = rng.uniform(0.0, 2.0) * damping / omega
    return LinearLoop((Mode(omega, damping, lead_s),), rng.uniform(0.0, 0.15))


def lightly_damped(rng: np.random.Generator) -> LinearLoop:
    """A loop whose own mode is lightly damped: a resonance of up to 20 dB."""
    omega, damping = rng.uniform(1.5, 5.0), rng.uniform(0.05, 0.15)
    return LinearLoop((Mode(omega, damping, rng.uniform(0.0, 0.1)),), rng.uniform(0.0, 0.1))


def flexible(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop that also shakes something: a narrow mode of little weight."""
    base = second_order(rng)
    damping = rng.uniform(0.03, 0.1)
    height = rng.uniform(0.1, 0.5) * rng.choice([-1.0, 1.0])
    shaken = Mode(rng.uniform(1.5, 5.0), damping, gain=2 * damping * height)
    return LinearLoop((*base.modes, shaken), base.delay_s)


def gain_and_delay(rng: np.random.Generator) -> LinearLoop:
    """A well-damped loop whose gain is not 1 and whose delay is long."""
    omega, damping, gain = rng.uniform(2.0, 6.0), rng.uniform(0.5, 1.0), rng.uniform(0.7, 1.3)
    return LinearLoop((Mode(omega, damping, gain=gain),), rng.uniform(0.0, 0.4))


def mildly_nonlinear(rng: np.random.Generator) -> NonlinearLoop:
    """A well-damped loop whose actuator has a dead zone, or cannot change as fast as asked."""
    linear = second_order(rng)
    mode = linear.modes[0]
    dead = bool(rng.integers(2))
    return NonlinearLoop(
        omega_rad_s=mode.omega_rad_s,
        damping=mode.damping,
        lead_s=mode.lead_s,
        delay_s=linear.delay_s,
        dead_zone_m_s2=rng.uniform(0.01, 0.05) if dead else 0.0,
        rate_max_m_s3=math.inf if dead else rng.uniform(25.0, 50.0),
    )


def strongly_nonlinear(rng: np.random.Generator) -> NonlinearLoop:
    """The same, but so nonlinear that the responses to many tones and to one tone differ."""
    mild = mildly_nonlinear(rng)
    if mild.dead_zone_m_s2 > 0:
        return replace(mild, dead_zone_m_s2=rng.uniform(0.1, 0.3))
    return replace(mild, rate_max_m_s3=rng.uniform(12.0, 25.0))


FAMILIES: dict[str, Callable[[np.random.Generator], LinearLoop | NonlinearLoop]] = {
    "second-order": second_order,
    "lightly-damped": lightly_damped,
    "flexible": flexible,
    "gain-and-delay": gain_and_delay,
    "mildly-nonlinear": mildly_nonlinear,
    "strongly-nonlinear": strongly_nonlinear,
}


def random_fleet(family: str, sources: int, noise_m: float, rng: np.random.Generator) -> Fleet:
    """Draw a target and sources of one family.

    The true response of a nonlinear robot is the one to single tones of the amplitude that the
    robot itself chooses for them, without noise.
    """
    draw = FAMILIES[family]
    robots = [TestedRobot(draw(rng), noise_m, rng) for _ in range(sources + 1)]
    if isinstance(robots[0].loop, NonlinearLoop):
        omega = np.geomspace(*BAND_RAD_S, 40)
    else:
        omega = np.linspace(*BAND_RAD_S, TRUTH_POINTS)
    z = [true_response(robot, omega) for robot in robots]
    named = {f"source-{n}": robot for n, robot in enumerate(robots[1:], start=1)}
    distances = [float(chordal_distance(z[0], other).max()) for other in z[1:]]
    return Fleet(robots[0], named, dict(zip(named, distances, strict=True)))


def true_response(robot: TestedRobot, omega_rad_s: FloatArray) -> ComplexArray:
    """Return z without noise; of a nonlinear robot as `random_fleet` says."""
    if isinstance(robot.loop, LinearLoop):
        return robot.loop.response(omega_rad_s)
    return np.array([_to_one_tone(robot.loop, robot.spec, omega) for omega in omega_rad_s.tolist()])


def _to_one_tone(loop: NonlinearLoop, spec: RobotSpec, omega_rad_s: float) -> complex:
    """Return the fundamental of a nonlinear robot's response over that of the reference."""
    single = Excitation(axis="x", tones=(Tone(omega_rad_s=omega_rad_s),), segments=3)
    plan = plan_excitation(single, spec, "robot")
    reference = reference_of(plan)
    response = play(loop, reference, SAMPLE_TIME_S)
    first = plan.first_measured_sample
    measured = slice(first, first + plan.segments * plan.segment_samples)
    phase = omega_rad_s * np.arange(plan.samples)[measured] * SAMPLE_TIME_S
    columns = np.stack([np.cos(phase), np.sin(phase), np.ones(len(phase))], axis=1)
    both = np.stack([reference[measured], response[measured]], axis=1)
    cosine, sine, _ = np.linalg.lstsq(columns, both, rcond=None)[0]
    u, y = cosine - 1j * sine
    return complex(y / u)


def _decay(mode: Mode) -> float:
    """Return the decay rate of a mode's slowest pole."""
    if mode.damping <= 1:
        return mode.damping * mode.omega_rad_s
    return mode.omega_rad_s * (mode.damping - math.sqrt(mode.damping**2 - 1))
