"""The interface between an agent and the robot beside it, simulated or real."""

from __future__ import annotations

from abc import ABC, abstractmethod

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.spec import RobotSpec


class Robot(ABC):
    """A robot under its own baseline controller: references in, measured outputs out.

    A robot rests at reference 0 of every axis: there `connect` and `rest` leave it, there every
    motion begins, and its first reference is 0. The reference that the robot holds at rest is the
    driver's own, so the way to 0 is too; a driver that rests where it happens to be would see its
    reference jump when the next motion begins. The agent compares the output at rest with the first
    reference, and begins nothing when they are further apart than
    `nufleet.robot_agent.motion.monitor` says.

    One sample is `spec.sample_time_s`. References and outputs hold one number per axis, in the
    order and the units of `spec.axes`. Methods are called from one thread at a time. Each raises
    `RobotError` when the robot cannot do what is asked.
    """

    @property
    @abstractmethod
    def spec(self) -> RobotSpec:
        """What the robot is; may be read while disconnected."""

    @abstractmethod
    def connect(self) -> None:
        """Make the robot ready to move, at rest at reference 0."""

    @abstractmethod
    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (axes,); commands nothing.

        It is asked for three to eight times before each motion, to find out where the robot is and
        how noisy its sensor: wait for the sensor's next sample, and return it as it is, unfiltered.
        """

    @abstractmethod
    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; return the output measured at the sample's start.

        Args:
            reference: shape (axes,).

        Returns:
            The measured output, shape (axes,). y(k) is measured before the reference y_r(k) acts.
        """

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal known ahead; the same as `step` for each row.

        Args:
            references: shape (samples, axes).

        Returns:
            The measured outputs, shape (samples, axes).
        """
        outputs = np.empty_like(references)
        for k, reference in enumerate(references):
            outputs[k] = self.step(reference)
        return outputs

    @property
    def state_names(self) -> tuple[str, ...]:
        """What `observe` measures on every axis, for example ("position", "velocity", "tilt").

        The first one is the axis's output. Empty for a robot that measures nothing but its output.
        """
        return ()

    def observe(self) -> FloatArray:
        """Measure the state now, between two samples; the robot does not move on.

        Feedback reads it before choosing the next reference: `observe` at sample k and the y(k)
        that the next `step` returns are one and the same measurement.

        Returns:
            Shape (axes, len(state_names)), in the axis's unit and its time derivatives; angles in
            rad.
        """
        return np.empty((len(self.spec.axes), 0))

    @abstractmethod
    def rest(self) -> None:
        """Bring the robot to rest at reference 0, from whatever it is doing; returns when it is.

        The way there is the driver's own: no faster than the robot may go, whatever the reference
        was last. Called at the end of every motion, and in the middle of one that is stopped.
        """

    @abstractmethod
    def disconnect(self) -> None:
        """Leave the robot at rest and let go of it. Calling it twice does nothing more."""
