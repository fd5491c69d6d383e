"""Robots and limits that the tests of learning share."""

from __future__ import annotations

from collections import deque

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

LIMITS = TrackingLimits(
    position_max=1.5,
    speed_max=1.0,
    acceleration_max=2.0,
    correction_max=0.5,
    correction_speed_max=0.6,
)


def double_integrator(
    alpha: float = 0.85, beta: float = 0.003, noise_std_m: float = 0.0
) -> DoubleIntegrator:
    settings = DoubleIntegratorSettings(alpha=alpha, beta=beta, noise_std_m=noise_std_m)
    robot = DoubleIntegrator(settings, np.random.default_rng(0))
    robot.connect()
    return robot


class LaggedRobot(Robot):
    """Two axes; each output is the reference some samples late, measured with noise.

    `fails_at` and `blind_at` are samples at which it fails or measures NaN.
    """

    def __init__(
        self,
        delays: tuple[int, int] = (3, 3),
        noise_std_m: float = 0.0,
        fails_at: int | None = None,
        blind_at: int | None = None,
    ) -> None:
        self._past = [deque([0.0] * delay, delay) for delay in delays]
        self._noise_std_m, self._rng = noise_std_m, np.random.default_rng(0)
        self._rest_rng = np.random.default_rng(1)
        self._fails_at, self._blind_at = fails_at, blind_at
        self._now: FloatArray | None = None
        self.samples, self.rests = 0, 0

    @property
    def spec(self) -> RobotSpec:
        axes = tuple(
            AxisSpec(name=name, unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=2.0)
            for name in ("x", "y")
        )
        return RobotSpec(
            kind="lagged",
            axes=axes,
            sample_time_s=0.02,
            omega_min_rad_s=0.1,
            omega_max_rad_s=6.0,
            duration_max_s=100.0,
            settling_time_s=0.5,
            simulated=True,
            tracking=LIMITS,
        )

    @property
    def state_names(self) -> tuple[str, ...]:
        return ("position",)

    def connect(self) -> None:
        pass

    def measure_output(self) -> FloatArray:
        noise = self._noise_std_m * self._rest_rng.standard_normal(2)
        return np.array([past[0] for past in self._past]) + noise

    def observe(self) -> FloatArray:
        if self._now is None:
            noise = self._noise_std_m * self._rng.standard_normal(2)
            self._now = np.array([past[0] for past in self._past]) + noise
            if self.samples == self._blind_at:
                self._now[0] = np.nan
        return self._now[:, np.newaxis].copy()

    def step(self, reference: FloatArray) -> FloatArray:
        if self.samples == self._fails_at:
            raise RobotError("it fell over")
        output = self.observe()[:, 0]
        self._now = None
        self.samples += 1
        for past, value in zip(self._past, reference, strict=True):
            past.append(float(value))
        return output

    def rest(self) -> None:
        self.rests += 1
        for past in self._past:
            past.extend([0.0] * len(past))
        self._now = None

    def disconnect(self) -> None:
        pass
