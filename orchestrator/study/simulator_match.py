"""How well a simulator's response matches a robot's, and in which way the two differ.

The distance at each tone is the chordal distance ψ of the paper. The difference in words comes from
the closest of the loops g e^{−jωτ} z(ω/√k), where z is the simulator's response: g is a ratio of
gains, τ a delay, and k a ratio of stiffnesses at equal mass, by which the loop is √k times as fast.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance, chordal_variance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.strict import NonNegative, Positive, Strict

TONES_MIN = 5
"""Fewest tones from which gain, delay and stiffness are estimated."""

DEVIATIONS = 2.0
"""Standard deviations from which a difference is stated."""

LEFT_MAX = 0.5
"""Share of the distance that delay, gain and stiffness may leave if they are stated in words."""

NOISE_DEVIATIONS = 4.0
"""Standard deviations that noise alone does not reach at the worst of some tens of tones."""

MODEL_ERROR = 1e-3
"""Share of a response that the interpolation between the simulator's tones may be off."""

INTERVAL_DEVIATIONS = 1.96
"""Standard deviations on either side of the interval of a distance, for 95 %."""


class Difference(Strict):
    """One quantity in which a robot differs from its simulator."""

    value: float
    """Estimate: a delay in s, or a ratio less 1."""
    std: NonNegative
    """Its standard deviation."""

    @property
    def significant(self) -> bool:
        """Whether it exceeds what noise alone would show."""
        return abs(self.value) > DEVIATIONS * self.std


class ToneDistance(Strict):
    """The distance between a robot and its simulator at one frequency."""

    omega_rad_s: Positive
    """Frequency."""
    psi: NonNegative
    """Chordal distance."""
    psi_std: NonNegative
    """Its standard deviation."""


class SimulatorMatch(Strict):
    """How well one simulator matches a robot."""

    simulator: str
    """Name of the simulated robot."""
    psi: NonNegative
    """Largest distance over the tones."""
    psi_low: NonNegative
    psi_high: NonNegative
    """Interval of 95 % of that distance."""
    omega_rad_s: Positive
    """Frequency at which it is attained."""
    tones: tuple[ToneDistance, ...]
    """Distances at all tones that both played, by frequency."""
    delay_s: Difference | None
    """Time by which the robot answers later; None with too few tones."""
    gain: Difference | None
    """Ratio of the robot's gain to the simulator's, less 1."""
    stiffness: Difference | None
    """Ratio of the robot's stiffness to the simulator's, less 1."""
    psi_explained: NonNegative | None
    """Largest distance that these three differences would leave."""

    @property
    def _unexplained(self) -> bool:
        """Whether the two differ by more than noise would show, and the three tell little of it."""
        if self.psi_explained is None or self.psi_explained <= LEFT_MAX * self.psi:
            return False
        std = (self.psi_high - self.psi) / INTERVAL_DEVIATIONS
        return self.psi > NOISE_DEVIATIONS * std

    @property
    def words(self) -> str:
        """The difference in words."""
        said = []
        if self.delay_s is not None and self.delay_s.significant:
            when = "later" if self.delay_s.value > 0 else "earlier"
            said.append(f"answers {1e3 * abs(self.delay_s.value):.2g} ms {when}")
        if self.stiffness is not None and self.stiffness.significant:
            how = "stiffer" if self.stiffness.value > 0 else "softer"
            said.append(f"is {100 * abs(self.stiffness.value):.2g} % {how}")
        if self.gain is not None and self.gain.significant:
            how = "more" if self.gain.value > 0 else "less"
            said.append(f"moves {100 * abs(self.gain.value):.2g} % {how}")
        if self.delay_s is None:
            return f"too few tones to tell how they differ: at least {TONES_MIN} are needed"
        if self._unexplained:
            return (
                f"the robot differs from {self.simulator} in another way than by a delay, a "
                f"stiffness and a gain: the closest of these leave ψ {self.psi_explained:.3f} of "
                f"{self.psi:.3f}"
            )
        if not said:
            return "no delay, gain or stiffness differs by more than its uncertainty"
        listed = said[0] if len(said) == 1 else f"{', '.join(said[:-1])} and {said[-1]}"
        return f"the robot {listed} than {self.simulator}"


@dataclass(frozen=True)
class Tones:
    """A response at the tones of several tests, each tone once."""

    omega_rad_s: FloatArray
    """Frequencies, rising, shape (tones,)."""
    z: ComplexArray
    """Estimates, shape (tones,)."""
    variance: FloatArray
    """E|ẑ − z|² of each, shape (tones,)."""


def match_simulator(
    simulator: str,
    robot_tests: Sequence[FrequencyResponse],
    simulator_tests: Sequence[FrequencyResponse],
) -> SimulatorMatch:
    """Compare a simulator with a robot at the tones that both played.

    Args:
        simulator: Name of the simulated robot.
        robot_tests: Usable tests of the robot.
        simulator_tests: Usable tests of the simulator.

    Raises:
        StudyError: They played no tone in common.
    """
    robot, model = pooled(robot_tests), pooled(simulator_tests)
    omega, in_robot, in_model = np.intersect1d(
        robot.omega_rad_s, model.omega_rad_s, return_indices=True
    )
    if not len(omega):
        raise StudyError(f"{simulator} and the robot played no tone in common")
    z, modelled = robot.z[in_robot], model.z[in_model]
    variances = robot.variance[in_robot], model.variance[in_model]
    psi = chordal_distance(z, modelled)
    std = np.sqrt(chordal_variance(z, variances[0], modelled, variances[1]))
    worst = int(np.argmax(psi))
    spread = INTERVAL_DEVIATIONS * float(std[worst])
    fit = None
    if len(omega) >= TONES_MIN:
        fit = _fit(omega, z, modelled, variances[0] + variances[1])
    delay, gain, stiffness, left = fit or (None, None, None, None)
    return SimulatorMatch(
        simulator=simulator,
        psi=float(psi[worst]),
        psi_low=max(0.0, float(psi[worst]) - spread),
        psi_high=min(1.0, float(psi[worst]) + spread),
        omega_rad_s=float(omega[worst]),
        tones=tuple(
            ToneDistance(omega_rad_s=w, psi=p, psi_std=s)
            for w, p, s in zip(omega.tolist(), psi.tolist(), std.tolist(), strict=True)
        ),
        delay_s=delay,
        gain=gain,
        stiffness=stiffness,
        psi_explained=left,
    )


def pooled(tests: Sequence[FrequencyResponse]) -> Tones:
    """Return all tones of several tests; those played repeatedly are averaged by their variance."""
    omegas = np.concatenate([test.omega_rad_s for test in tests])
    z = np.concatenate([test.z for test in tests])
    variance = np.concatenate([test.variance for test in tests])
    known = np.isfinite(z) & np.isfinite(variance)
    omega, which = np.unique(omegas[known], return_inverse=True)
    weights = 1 / np.maximum(variance[known], np.finfo(np.float64).tiny)
    total = np.bincount(which, weights)
    parts = (np.bincount(which, weights * part) for part in (z[known].real, z[known].imag))
    mean = np.asarray(next(parts) + 1j * next(parts), dtype=np.complex128) / total
    return Tones(omega, mean, 1 / total)


def _fit(
    omega: FloatArray, z: ComplexArray, modelled: ComplexArray, variance: FloatArray
) -> tuple[Difference, Difference, Difference, float]:
    """Return delay, gain and stiffness of the closest loop, and the distance that they leave."""
    from scipy.optimize import least_squares

    log_omega = np.log(omega)
    log_gain, phase = np.log(np.abs(modelled)), np.unwrap(np.angle(modelled))

    def loop(p: FloatArray) -> ComplexArray:
        log_g, delay_s, log_k = p
        at = log_omega - log_k / 2
        size = np.exp(_through(log_omega, log_gain, at) + log_g)
        turned = _through(log_omega, phase, at) - omega * delay_s
        return np.asarray(size * np.exp(1j * turned))

    deviation = np.sqrt(variance / 2 + (MODEL_ERROR * np.abs(z)) ** 2)

    def residual(p: FloatArray) -> FloatArray:
        off = (loop(p) - z) / deviation
        return np.concatenate([off.real, off.imag])

    scale = np.array([0.1, 0.1 / omega[-1], 0.1])
    best = least_squares(residual, np.zeros(3), x_scale=scale, loss="soft_l1")
    # What three numbers cannot explain makes them less certain than the noise does.
    excess = max(1.0, 2 * float(best.cost) / max(1, 2 * len(omega) - 3))
    slope = np.asarray(best.jac, dtype=np.float64)
    stds = np.sqrt(np.diag(np.linalg.pinv(slope.T @ slope)) * excess)
    log_g, delay_s, log_k = best.x.tolist()
    left = float(chordal_distance(z, loop(best.x)).max())
    return (
        Difference(value=delay_s, std=float(stds[1])),
        Difference(value=float(np.expm1(log_g)), std=float(np.exp(log_g) * stds[0])),
        Difference(value=float(np.expm1(log_k)), std=float(np.exp(log_k) * stds[2])),
        left,
    )


def _through(x: FloatArray, y: FloatArray, at: FloatArray) -> FloatArray:
    """Return a cubic spline through (x, y), continued by straight lines."""
    from scipy.interpolate import CubicSpline

    spline = CubicSpline(x, y, bc_type="natural")
    inside = np.clip(at, x[0], x[-1])
    return np.asarray(spline(inside) + spline(inside, 1) * (at - inside))
