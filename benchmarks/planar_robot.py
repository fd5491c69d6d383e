"""Two of Section V's robots as one with the axes x and y, and a clock that paces any robot."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings


class PlanarRobot(Robot):
    """One double integrator for each of the axes x and y."""

    def __init__(self, x: DoubleIntegrator, y: DoubleIntegrator) -> None:
        self._parts = (x, y)
        axes = (x.spec.axes[0], y.spec.axes[0].model_copy(update={"name": "y"}))
        self._spec = x.spec.model_copy(update={"kind": "planar-double-integrator", "axes": axes})

    @property
    def spec(self) -> RobotSpec:
        """What the robot is."""
        return self._spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """What `observe` measures."""
        return self._parts[0].state_names

    def connect(self) -> None:
        """Put both axes at rest at 0."""
        for part in self._parts:
            part.connect()

    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (2,)."""
        return np.concatenate([part.measure_output() for part in self._parts])

    def observe(self) -> FloatArray:
        """Measure the state now, shape (2, 2)."""
        return np.concatenate([part.observe() for part in self._parts])

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; shapes (2,)."""
        return np.asarray(self.run(reference[np.newaxis])[0])

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal; shapes (samples, 2)."""
        columns = [part.run(references[:, [i]]) for i, part in enumerate(self._parts)]
        return np.concatenate(columns, axis=1)

    def rest(self) -> None:
        """Bring both axes to rest."""
        for part in self._parts:
            part.rest()

    def disconnect(self) -> None:
        """Let go of both axes."""
        for part in self._parts:
            part.disconnect()


def tracking_limits(robot: Robot) -> TrackingLimits:
    """Return what paths may ask of a robot that tracks."""
    if robot.spec.tracking is None:
        raise RobotError(f"a {robot.spec.kind} has no tracking limits")
    return robot.spec.tracking


def planar_double_integrator(noise_std_m: float) -> PlanarRobot:
    """Return the target of Section V on two axes, ready to move, samples of 15 ms."""
    settings = DoubleIntegratorSettings(alpha=0.85, beta=0.003, noise_std_m=noise_std_m)
    x, y = (DoubleIntegrator(settings, rng) for rng in np.random.default_rng(0).spawn(2))
    robot = PlanarRobot(x, y)
    robot.connect()
    return robot


class ClockedRobot(Robot):
    """A robot whose samples begin at ticks of a clock, no matter how long the controller takes.

    `observe` waits for the next tick. The ticks are fixed when the first one is waited for: a
    controller that is late once has less time left for the next sample. `reference_s` holds, for
    every observed sample, the time in seconds from its tick to the arrival of its reference.
    """

    def __init__(
        self,
        robot: Robot,
        now_s: Callable[[], float] = time.perf_counter,
        sleep: Callable[[float], None] = time.sleep,
    ) -> None:
        self._robot, self._now_s, self._sleep = robot, now_s, sleep
        self._first_tick_s: float | None = None
        self._observed = False
        self.reference_s: list[float] = []

    @property
    def spec(self) -> RobotSpec:
        """What the robot is."""
        return self._robot.spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """What `observe` measures."""
        return self._robot.state_names

    def connect(self) -> None:
        """Make the robot ready to move."""
        self._robot.connect()

    def measure_output(self) -> FloatArray:
        """Measure the output at rest."""
        return self._robot.measure_output()

    def observe(self) -> FloatArray:
        """Wait for the next tick, then measure the state."""
        if self._first_tick_s is None:
            self._first_tick_s = self._now_s()
        early_s = self._tick_s() - self._now_s()
        if early_s > 0:
            self._sleep(early_s)
        self._observed = True
        return self._robot.observe()

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample and note when it arrived."""
        if self._observed:
            self.reference_s.append(self._now_s() - self._tick_s())
            self._observed = False
        return self._robot.step(reference)

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal, as fast as the robot can."""
        return self._robot.run(references)

    def rest(self) -> None:
        """Bring the robot to rest."""
        self._robot.rest()

    def disconnect(self) -> None:
        """Let go of the robot."""
        self._robot.disconnect()

    def _tick_s(self) -> float:
        """Return when the sample begins that is observed next, or was observed last."""
        if self._first_tick_s is None:
            raise RuntimeError("no sample has been observed yet")
        return self._first_tick_s + len(self.reference_s) * self.spec.sample_time_s
