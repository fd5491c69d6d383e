"""The robot of the paper's Section V: a damped double integrator under a PD controller."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.shared.strict import NonNegative, Positive, Strict

SETTLED = 1e-4
"""Share to which the loop's slowest mode has decayed when a transient counts as negligible."""

STATE_NAMES = ("position", "velocity")

REST_TOLERANCE = 1e-6
"""Largest position in m and speed in m/s at rest, not counting the effect of noise."""

NOISE_MAX_M = 1e6
"""Largest standard deviation of the noise, far beyond all that is sensible."""


class DoubleIntegratorSettings(Strict):
    """Parameters of one robot; the paper's four robots differ in (α, β) and share the rest."""

    alpha: Positive
    """Gain α of the plant's input (paper, Section V-A)."""

    beta: NonNegative
    """Damping β of the plant (paper, Section V-A)."""

    k_p: Positive = 5.0
    """Proportional gain of the baseline controller, in 1/s² for a command that accelerates."""

    k_d: NonNegative = 4.5
    """Derivative gain of the baseline controller, in 1/s for a command that accelerates."""

    sample_time_s: Positive = 0.015
    """Sample time T_s of plant and controller."""

    noise_std_m: Annotated[NonNegative, Field(le=NOISE_MAX_M)] = 0.0
    """Standard deviation of the white measurement noise; the controller acts on the noisy output.
    """

    amplitude_max_m: Positive = 1.0
    """Largest amplitude of a frequency test."""

    velocity_max_m_s: Positive = 2.0
    """Largest velocity of a frequency test's reference."""

    acceleration_max_m_s2: Positive = 10.0
    """Largest acceleration of a frequency test's reference."""

    omega_min_rad_s: Positive = 0.01
    """Lower edge of the band for frequency tests."""

    omega_max_rad_s: Positive = 50.0
    """Upper edge of the band for frequency tests."""

    duration_max_s: Annotated[float, Field(gt=0, le=86_400)] = 3600.0
    """Longest motion that the robot accepts."""

    tracking: TrackingLimits = TrackingLimits(
        position_max=1.5,
        speed_max=1.0,
        acceleration_max=2.0,
        correction_max=0.5,
        correction_speed_max=0.6,
    )
    """Limits on tracked paths and their corrections, in m and s."""

    @model_validator(mode="after")
    def _loop_is_stable(self) -> DoubleIntegratorSettings:
        if slowest_pole(closed_loop(self)) >= 1.0:
            raise ValueError("the closed loop is not stable with these parameters")
        return self


def closed_loop(settings: DoubleIntegratorSettings) -> LinearModel:
    """Return the closed loop from y_r to y_a with the state (position, speed, e(k − 1)).

    The plant is the state equation printed in the paper's Section V-A taken literally, including
    A₁₂ = T_s − β. The controller is u(k) = k_p e(k) + k_d (e(k) − e(k − 1)) / T_s with the error
    e = y_r − y_a.
    """
    step_s = settings.sample_time_s
    b_1 = settings.alpha * step_s**2 / 2
    b_2 = settings.alpha * step_s
    past = settings.k_d / step_s
    now = settings.k_p + past
    return LinearModel(
        a=(
            (1.0 - b_1 * now, step_s - settings.beta, -b_1 * past),
            (-b_2 * now, 1.0 - settings.beta, -b_2 * past),
            (-1.0, 0.0, 0.0),
        ),
        b=(b_1 * now, b_2 * now, 1.0),
        c=(1.0, 0.0, 0.0),
        sample_time_s=step_s,
    )


def slowest_pole(model: LinearModel) -> float:
    """Return the largest magnitude among the model's poles, the eigenvalues of its matrix a."""
    return float(np.max(np.abs(np.linalg.eigvals(np.asarray(model.a)))))


class DoubleIntegrator(Robot):
    """A robot with one axis `x` in m that runs as fast as it can.

    Its measurement noise comes from the generator that it is given.
    """

    def __init__(self, settings: DoubleIntegratorSettings, rng: np.random.Generator) -> None:
        self._settings = settings
        self._rng = rng
        self._spec = _spec_of(settings)
        self._rest_bounds = _rest_bounds(settings)
        # Position, speed and the last control error; None while disconnected.
        self._state: tuple[float, float, float] | None = None
        # Noise of the current sample if `observe` has drawn it already; `run` then reuses it.
        self._noise_now_m: float | None = None
        # Measurements at rest draw from a stream of their own, so that they do not shift the noise
        # of the samples.
        self._rest_rng = rng.spawn(1)[0]

    @property
    def spec(self) -> RobotSpec:
        """Description of the robot; may be read while disconnected."""
        return self._spec

    def connect(self) -> None:
        """Put the robot at rest at 0."""
        self._state = (0.0, 0.0, 0.0)

    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (1,), in m."""
        if self._state is None:
            raise RobotError("the simulated double integrator is not connected")
        noise_m = self._settings.noise_std_m * self._rest_rng.standard_normal()
        return np.array([self._state[0] + noise_m])

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states that `observe` measures."""
        return STATE_NAMES

    def observe(self) -> FloatArray:
        """Measure position [m] and velocity [m/s], shape (1, 2); only the position is noisy."""
        if self._state is None:
            raise RobotError("the simulated double integrator is not connected")
        if self._noise_now_m is None:
            self._noise_now_m = float(self._draw_noise(1)[0])
        return np.array([[self._state[0] + self._noise_now_m, self._state[1]]])

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; reference and output have shape (1,), in m."""
        output: FloatArray = self.run(reference[None, :])[0]
        return output

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal; references and outputs have shape (samples, 1), in m."""
        return self.run_observed(references, ())[0]

    def run_observed(
        self, references: FloatArray, observed: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Follow a whole reference signal, and observe the states before some of its samples."""
        if self._state is None:
            raise RobotError("the simulated double integrator is not connected")
        if not np.isfinite(references).all():
            raise RobotError("the reference holds a number that is not finite")
        settings = self._settings
        step_s = settings.sample_time_s
        a_12, a_22 = step_s - settings.beta, 1.0 - settings.beta
        b_1, b_2 = settings.alpha * step_s**2 / 2, settings.alpha * step_s
        k_p, k_d = settings.k_p, settings.k_d / step_s
        position, speed, last_error = self._state
        noise = self._take_noise(len(references))
        measured, speeds = [], []
        # Python floats take about a microsecond per sample, a hundred times less than small arrays.
        for y_r, noise_m in zip(references[:, 0].tolist(), noise.tolist(), strict=True):
            y_a = position + noise_m
            measured.append(y_a)
            speeds.append(speed)
            error = y_r - y_a
            u = k_p * error + k_d * (error - last_error)
            position += a_12 * speed + b_1 * u
            speed = a_22 * speed + b_2 * u
            last_error = error
        self._state = (position, speed, last_error)
        states = np.array([[[measured[k], speeds[k]]] for k in observed])
        return np.array(measured)[:, None], states.reshape(len(observed), 1, len(STATE_NAMES))

    def _draw_noise(self, samples: int) -> FloatArray:
        return self._settings.noise_std_m * self._rng.standard_normal(samples)

    def _take_noise(self, samples: int) -> FloatArray:
        """Return the noise of the next samples, shape (samples,), including one already drawn."""
        if self._noise_now_m is None or samples == 0:
            return self._draw_noise(samples)
        seen, self._noise_now_m = self._noise_now_m, None
        return np.concatenate([[seen], self._draw_noise(samples - 1)])

    def rest(self) -> None:
        """Hold the reference at 0 until position and speed are within tolerance of 0."""
        zeros = np.zeros((max(1, round(1.0 / self._settings.sample_time_s)), 1))
        while not self._at_rest():
            self.run(zeros)

    def disconnect(self) -> None:
        """Bring the robot to rest and release it."""
        if self._state is not None:
            self.rest()
        self._state = None

    def _at_rest(self) -> bool:
        if self._state is None:
            raise RobotError("the simulated double integrator is not connected")
        position, speed, _ = self._state
        return abs(position) <= self._rest_bounds[0] and abs(speed) <= self._rest_bounds[1]


def _spec_of(settings: DoubleIntegratorSettings) -> RobotSpec:
    model = closed_loop(settings)
    settling_samples = math.ceil(math.log(SETTLED) / math.log(slowest_pole(model)))
    return RobotSpec(
        kind="double-integrator",
        axes=(
            AxisSpec(
                name="x",
                unit="m",
                amplitude_max=settings.amplitude_max_m,
                velocity_max=settings.velocity_max_m_s,
                acceleration_max=settings.acceleration_max_m_s2,
                model=model,
            ),
        ),
        sample_time_s=settings.sample_time_s,
        omega_min_rad_s=settings.omega_min_rad_s,
        omega_max_rad_s=settings.omega_max_rad_s,
        duration_max_s=settings.duration_max_s,
        settling_time_s=settling_samples * settings.sample_time_s,
        simulated=True,
        tracking=settings.tracking,
    )


def _rest_bounds(settings: DoubleIntegratorSettings) -> tuple[float, float]:
    """Return the largest position [m] and speed [m/s] at rest, where noise keeps the loop moving.

    The stationary covariance P of the state under the measurement noise of variance σ² solves the
    discrete Lyapunov equation P = A P Aᵀ + σ² b bᵀ: the noise enters the loop like a reference. The
    bounds are six standard deviations beyond `REST_TOLERANCE`.
    """
    model = closed_loop(settings)
    a, b = np.asarray(model.a), np.asarray(model.b)
    # With vec(A P Aᵀ) = (A ⊗ A) vec(P), the equation is an ordinary one for the entries of P.
    entries = np.linalg.solve(np.eye(a.size) - np.kron(a, a), np.outer(b, b).ravel())
    stationary = entries.reshape(a.shape) * settings.noise_std_m**2
    spread = 6.0 * np.sqrt(np.diag(stationary))
    return REST_TOLERANCE + float(spread[0]), REST_TOLERANCE + float(spread[1])
