"""The behaviour common to simulated robots: noisy measurement, coming to rest, latched failure."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import RobotSpec
from nufleet.sims.measurement_noise import MeasurementNoise


@dataclass(frozen=True)
class RestRule:
    """The return of a robot to its origin, and the condition under which it is at rest there."""

    speed: float
    """Largest speed of the reference on the return, in unit/s."""

    position_max: float
    """Largest distance from the origin at rest, in the axes' unit."""

    velocity_max: float
    """Largest velocity at rest, in unit/s."""

    patience_s: float
    """Time in seconds that coming to rest may take once the reference has reached the origin."""


class SimulatedRobot(Robot):
    """A robot whose simulator returns its true states: position, velocity and more on every axis.

    After a failure (a crash, or a number that is not finite) nothing moves until the robot is
    reconnected, as if a person had picked it up and put it back at its origin.
    """

    def __init__(
        self,
        name: str,
        spec: RobotSpec,
        state_names: tuple[str, ...],
        noise: MeasurementNoise,
        rest_rule: RestRule,
    ) -> None:
        self._name = name
        self._spec = spec
        self._state_names = state_names
        self._noise = noise
        self._rest_rule = rest_rule
        self._state: FloatArray | None = None
        self._reference = np.zeros(len(spec.axes))
        self._failure: str | None = None

    @property
    def spec(self) -> RobotSpec:
        """Description of the robot; may be read while disconnected."""
        return self._spec

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states that `observe` measures on every axis."""
        return self._state_names

    def connect(self) -> None:
        """Put the robot at rest at its origin, unless it is connected and has not failed."""
        if self._state is not None and self._failure is None:
            return
        self._state = None
        self._failure = None
        self._reference = np.zeros(len(self._spec.axes))
        self._state = self._start()

    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (axes,)."""
        return np.asarray((self._ready() + self._noise.aside())[:, 0])

    def observe(self) -> FloatArray:
        """Measure the state now, shape (axes, states)."""
        return self._ready() + self._noise.now

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; return the output at its start; shape (axes,)."""
        return np.asarray(self.run(reference[np.newaxis])[0])

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal; references and outputs have shape (samples, axes)."""
        return self.run_observed(references, ())[0]

    def run_observed(
        self, references: FloatArray, observed: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Follow a whole reference signal, and observe the states before some of its samples."""
        noise = self._noise.take(len(references))
        states, seen = self._advance(references), list(observed)
        return np.asarray(states[:, :, 0] + noise[:, :, 0]), states[seen] + noise[seen]

    def rest(self) -> None:
        """Return to the origin along a smooth path and wait there until nothing moves any more."""
        rule, sample_time_s = self._rest_rule, self._spec.sample_time_s
        self._ready()
        path = path_to_rest(self._reference, rule.speed, sample_time_s)
        self._noise.take(len(path))
        self._advance(path)
        window = np.zeros((math.ceil(0.5 / sample_time_s), len(self._spec.axes)))
        for _ in range(math.ceil(rule.patience_s / 0.5)):
            self._noise.take(len(window))
            states = np.abs(self._advance(window))
            if (states[:, :, 0] < rule.position_max).all() and (
                states[:, :, 1] < rule.velocity_max
            ).all():
                return
        raise RobotError(
            f"{self._name} did not come to rest within {rule.patience_s:g} s of its origin"
        )

    def disconnect(self) -> None:
        """Leave the robot at rest and release it."""
        if self._state is not None and self._failure is None:
            self.rest()
        self._state = None
        self._failure = None

    @abstractmethod
    def _start(self) -> FloatArray:
        """Put the simulation at rest at the origin; return the true state, (axes, states)."""

    @abstractmethod
    def _play(self, references: FloatArray) -> FloatArray:
        """Advance the simulation.

        Args:
            references: Finite references, shape (samples, axes), in the axes' units.

        Returns:
            The true states before each reference acts and after the last one has acted, shape
            (samples + 1, axes, states).

        Raises:
            RobotError: The robot has failed and cannot continue.
        """

    def _advance(self, references: FloatArray) -> FloatArray:
        self._ready()
        if not np.isfinite(references).all():
            raise RobotError(f"{self._name} was given a reference that is not finite")
        if len(references) == 0:
            return np.empty((0, len(self._spec.axes), len(self._state_names)))
        try:
            states = self._play(references)
        except RobotError as error:
            self._failure = str(error)
            raise
        self._reference = references[-1].copy()
        self._state = states[-1]
        return states[:-1]

    def _ready(self) -> FloatArray:
        if self._failure is not None:
            raise RobotError(f"{self._name} has to be reconnected: {self._failure}")
        if self._state is None:
            raise RobotError(f"{self._name} is not connected")
        return self._state


def path_to_rest(start: FloatArray, speed: float, sample_time_s: float) -> FloatArray:
    """Return a raised-cosine path from a point to zero.

    Args:
        start: First point, shape (axes,), in the axes' units.
        speed: Largest speed on any axis, in unit/s.
        sample_time_s: Sample time in seconds.

    Returns:
        The path, shape (samples, axes), at least one second long and ending at zero.
    """
    # The steepest slope of (1 + cos(π t / T)) / 2 is π / (2 T).
    duration_s = max(1.0, math.pi / 2 * float(np.abs(start).max()) / speed)
    samples = math.ceil(duration_s / sample_time_s)
    fraction = np.arange(1, samples + 1) / samples
    return np.outer((1 + np.cos(math.pi * fraction)) / 2, start)
