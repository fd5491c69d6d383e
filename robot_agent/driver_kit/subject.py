"""The robot that is examined: how it is moved, and what is measured of it."""

from __future__ import annotations

import math
import threading
import time
from dataclasses import dataclass, field

import numpy as np

from nufleet.robot_agent.motion.monitor import rest_measurements
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError

HOLD_S = 1.0
"""Time for which a robot holds reference 0."""

AMPLITUDE_SHARE = 0.2
"""Share of an axis's amplitude limit by which the robot is moved."""

GENTLE_SHARE = 0.3
"""Share of the limits on velocity and acceleration that such a motion needs, at most."""


@dataclass
class Subject:
    """A robot under examination, with what is known of it until now."""

    robot: Robot
    """The robot."""

    noise: FloatArray | None = None
    """Standard deviation of the output at rest, shape (axes,); None before it was measured."""

    played: int = 0
    """Number of samples since the robot rested."""

    lasted_s: float = 0.0
    """Duration of the last motion on the wall clock."""

    up: bool = False
    """Whether the robot may be moving, or ready to: it was begun, and not ended since."""

    interrupted: threading.Event = field(default_factory=threading.Event)
    """Whether no further reference is to be played, because a person ends the examination."""

    def begin(self) -> None:
        """Let the robot get ready to move."""
        self.up = True
        self.robot.begin()

    def end(self) -> None:
        """Let it land and disarm."""
        self.robot.end()
        self.up = False

    def play(self, references: FloatArray) -> FloatArray:
        """Play references, shape (samples, axes), sample by sample, as an agent would."""
        spec, outputs = self.robot.spec, np.full(references.shape, np.nan)
        began_s = time.monotonic()
        for k, reference in enumerate(references):
            if self.interrupted.is_set():
                raise RobotError("interrupted")
            output = self.robot.step(reference)
            if np.shape(output) != (len(spec.axes),) or not np.isfinite(output).all():
                raise RobotError(f"`step` returned {output!r} at sample {k}")
            outputs[k] = output
        self.lasted_s = time.monotonic() - began_s
        self.played += len(references)
        return outputs

    def hold(self) -> FloatArray:
        """Play reference 0 for `HOLD_S`; return the outputs, shape (samples, axes)."""
        spec = self.robot.spec
        return self.play(np.zeros((math.ceil(HOLD_S / spec.sample_time_s), len(spec.axes))))

    @property
    def known_noise(self) -> FloatArray:
        """Standard deviation of the output at rest, shape (axes,); 0 before it was measured."""
        return np.zeros(len(self.robot.spec.axes)) if self.noise is None else self.noise

    def rest(self) -> None:
        """Bring the robot to rest."""
        self.robot.rest()
        self.played = 0

    def measured(self) -> FloatArray:
        """Measure the output at rest as often as an agent does, shape (measurements, axes)."""
        return np.stack(
            [self.robot.measure_output() for _ in range(rest_measurements(self.robot.spec))]
        )


def gentle_hill(robot: Robot, axis: int) -> FloatArray:
    """Return a raised cosine from 0 to a small amplitude and back, shape (samples,).

    It stays well below all limits of the axis, and takes twice the robot's settling time.
    """
    spec, limits = robot.spec, robot.spec.axes[axis]
    amplitude = AMPLITUDE_SHARE * limits.amplitude_max
    # A (1 − cos ω t) / 2 reaches the velocity A ω / 2 and the acceleration A ω² / 2.
    omega = min(
        spec.omega_max_rad_s / 2,
        math.pi / max(spec.settling_time_s, spec.sample_time_s),
        2 * GENTLE_SHARE * limits.velocity_max / amplitude,
        math.sqrt(2 * GENTLE_SHARE * limits.acceleration_max / amplitude),
    )
    samples = max(8, math.ceil(2 * math.pi / omega / spec.sample_time_s))
    hill: FloatArray = amplitude * (1 - np.cos(2 * np.pi * np.arange(samples) / samples)) / 2
    return hill
