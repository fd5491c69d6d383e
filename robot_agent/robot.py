"""The interface between an agent and the robot beside it, simulated or real."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec


@dataclass(frozen=True, eq=False)
class Record:
    """What was measured during a motion, with the times at which it was.

    All times are in s on one clock, which the driver chooses; device time stamps are converted to
    it.
    """

    sample_s: FloatArray
    """Time at which the reference of each sample was sent, shape (samples,), increasing."""

    measured_s: FloatArray
    """Time at which each measurement was taken, shape (measurements,), increasing."""

    outputs: FloatArray
    """Measured outputs, shape (measurements, axes), in the axes' units."""

    clock_std_s: float = 0.0
    """Standard deviation of the error, in s, that all of `measured_s` have in common in one motion,
    as by time stamps of coarse resolution. What is unknown of the delay in all motions alike is
    `RobotSpec.delay_uncertainty_s`."""


def _never() -> bool:
    return False


class Robot(ABC):
    """A robot under its own baseline controller: references in, measured outputs out.

    A robot rests at reference 0 of every axis: `begin` and `rest` leave it there, and every motion
    begins there with a first reference of 0. The driver itself chooses the reference that
    holds the robot at rest, and therefore also how to get to 0. If a driver rested at the present
    position of the robot, its reference would jump when the next motion begins. The agent compares
    the output at rest with the first reference, and refuses to begin a motion when they are further
    apart than `nufleet.robot_agent.motion.monitor` allows.

    One sample lasts `spec.sample_time_s`. References and outputs hold one number per axis, in the
    order and the units of `spec.axes`. Methods are called from one thread at a time, except for
    `health` and `kill`. Each raises `RobotError` when the robot cannot do what it is asked to, and
    `RobotDownError` when it cannot even come to rest any more.

    Calls come in this order: `connect`; then, as often as needed, `begin`, motions that each end
    with `rest`, and `end`; at last `disconnect`. Between two calls a robot that has begun keeps its
    place by itself, as long as its driver's process lives.

    Examples:
        A robot that reaches its reference within one sample:

        >>> from nufleet.shared.robots.spec import AxisSpec
        >>> class Follower(Robot):
        ...     spec = RobotSpec(
        ...         kind="follower",
        ...         axes=(
        ...             AxisSpec(
        ...                 name="x", unit="m", amplitude_max=1, velocity_max=1, acceleration_max=1
        ...             ),
        ...         ),
        ...         sample_time_s=0.02,
        ...         omega_min_rad_s=0.1,
        ...         omega_max_rad_s=6.0,
        ...         duration_max_s=300.0,
        ...         settling_time_s=4.0,
        ...         simulated=True,
        ...     )
        ...
        ...     def connect(self):
        ...         self.output = np.zeros(1)
        ...
        ...     def measure_output(self):
        ...         return self.output
        ...
        ...     def step(self, reference):
        ...         measured, self.output = self.output, reference
        ...         return measured
        ...
        ...     def rest(self):
        ...         self.output = np.zeros(1)
        ...
        ...     def disconnect(self):
        ...         self.rest()
        >>> robot = Follower()
        >>> robot.connect()
        >>> robot.run(np.array([[0.0], [0.1], [0.2]])).ravel()
        array([0. , 0. , 0.1])
    """

    called_off: Callable[[], bool] = staticmethod(_never)
    """Whether the motion for which the robot begins has been stopped meanwhile; set by the agent.

    A driver whose `begin` takes a while calls `check_wanted` before arming and before take-off.
    """

    def check_wanted(self) -> None:
        """Raise RobotError if the motion for which the robot begins has been stopped meanwhile."""
        if self.called_off():
            raise RobotError("it was stopped before it took off")

    @property
    @abstractmethod
    def spec(self) -> RobotSpec:
        """Description of the robot; may be read while disconnected."""

    @abstractmethod
    def connect(self) -> None:
        """Reach the robot and its sensors; a robot that flies stays on the ground.

        A robot that needs no `begin` is ready to move afterwards, at rest at reference 0. Every
        call after a `disconnect` or a failed `connect` is a new attempt.
        """

    def begin(self) -> None:  # noqa: B027 - most robots need nothing
        """Get ready to move: arm, take off, and come to rest at reference 0.

        The agent calls this before a motion if the robot has not begun since it was connected or
        ended. Does nothing unless overridden.
        """

    def end(self) -> None:  # noqa: B027 - most robots need nothing
        """Undo `begin`, from any state: land, and disarm.

        The agent calls this when `spec.idle_s` has passed without a motion, after a fault, when
        `begin` failed, and before it disconnects. Does nothing unless overridden.
        """

    @abstractmethod
    def measure_output(self) -> FloatArray:
        """Measure the output at rest without commanding anything.

        The agent calls this three to eight times before each motion, to find out where the robot is
        and how noisy its sensor is. An implementation waits for the sensor's next sample and
        returns it as it is, unfiltered.

        Returns:
            The measured output, shape (axes,), in the axes' units.
        """

    @abstractmethod
    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; return the output measured at the sample's start.

        Args:
            reference: Reference y_r(k), shape (axes,), in the axes' units.

        Returns:
            The output y(k), shape (axes,), in the axes' units, measured before y_r(k) acts.
        """

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal known ahead; equivalent to `step` for each row.

        Args:
            references: References, shape (samples, axes), in the axes' units.

        Returns:
            The measured outputs, shape (samples, axes), in the axes' units.
        """
        outputs = np.empty_like(references)
        for k, reference in enumerate(references):
            outputs[k] = self.step(reference)
        return outputs

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states that `observe` measures on every axis.

        For example ("position", "velocity", "tilt"). The first state is the axis's output. Empty
        for a robot that measures only its output.
        """
        return ()

    def observe(self) -> FloatArray:
        """Measure the state between two samples; the robot does not advance.

        A feedback controller reads it before choosing the next reference. The output that `observe`
        returns at sample k and the y(k) that the next `step` returns are the same measurement.

        Returns:
            The state, shape (axes, len(state_names)), in the axis's unit and its time derivatives;
            angles in rad.
        """
        return np.empty((len(self.spec.axes), 0))

    def run_observed(
        self, references: FloatArray, observed: Sequence[int]
    ) -> tuple[FloatArray, FloatArray]:
        """Follow a whole reference signal, and observe the states before some of its samples.

        Equivalent to `run` and `observe` in turn. A simulator that knows its states all along does
        better to play the signal at once.

        Args:
            references: References, shape (samples, axes), in the axes' units.
            observed: Indices of these samples, rising.

        Returns:
            The measured outputs, shape (samples, axes), and the states as `observe` measures them,
            shape (observed, axes, states).
        """
        outputs = np.empty_like(references)
        states = np.empty((len(observed), len(self.spec.axes), len(self.state_names)))
        done = 0
        for i, k in enumerate(observed):
            if k > done:
                outputs[done:k] = self.run(references[done:k])
            states[i] = self.observe()
            done = k
        if done < len(references):
            outputs[done:] = self.run(references[done:])
        return outputs, states

    def record(self) -> Record | None:
        """Return the measurements of the frequency test just played, before `rest` is called.

        A real robot's measurement takes a while to arrive, so that `step` can only return the
        newest one. With a record of all samples since the robot rested, the agent estimates
        afterwards what the outputs were at the samples. None, the default, means that `step`
        returned the outputs at the samples.
        """
        return None

    def health(self) -> Health | None:
        """Return the robot's condition; None, the default, for a robot that reports none.

        The agent calls this twice a second from a thread of its own, also while another call is in
        progress. It returns at once what the driver knows.
        """
        return None

    def kill(self) -> None:
        """Cut the motors now; a robot that flies falls.

        Called from any thread, also while another call is in progress, which should then raise
        `RobotDownError`. It returns within a second, and takes no lock that another call holds.

        Raises:
            RobotError: The robot has no such switch, which is the default, or it failed.
        """
        raise RobotError("the driver of this robot has no way of cutting its motors")

    @abstractmethod
    def rest(self) -> None:
        """Bring the robot to rest at reference 0 from any state; returns when it rests there.

        The driver chooses the path from the last reference, no faster than the robot may move. This
        is called at the end of every motion, and in the middle of one that is stopped.
        """

    @abstractmethod
    def disconnect(self) -> None:
        """Leave the robot at rest and release it; a second call does nothing."""


class RobotAround(Robot):
    """A robot that is another one with something added: passes on every call it does not change."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot

    @property
    def called_off(self) -> Callable[[], bool]:
        """Whether the motion for which the robot inside begins has been stopped meanwhile."""
        return self._robot.called_off

    @called_off.setter
    def called_off(self, asked: Callable[[], bool]) -> None:
        self._robot.called_off = asked

    @property
    def spec(self) -> RobotSpec:
        """Description of the robot inside."""
        return self._robot.spec

    def connect(self) -> None:
        """Connect the robot inside."""
        self._robot.connect()

    def begin(self) -> None:
        """Get the robot inside ready to move."""
        self._robot.begin()

    def end(self) -> None:
        """End what `begin` began."""
        self._robot.end()

    def record(self) -> Record | None:
        """Return the measurements of the motion just played."""
        return self._robot.record()

    def health(self) -> Health | None:
        """Return the condition of the robot inside."""
        return self._robot.health()

    def kill(self) -> None:
        """Cut the motors of the robot inside."""
        self._robot.kill()

    def measure_output(self) -> FloatArray:
        """Measure the output at rest, shape (axes,)."""
        return self._robot.measure_output()

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; reference and output have shape (axes,)."""
        return self._robot.step(reference)

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal; references and outputs have shape (samples, axes)."""
        return self._robot.run(references)

    @property
    def state_names(self) -> tuple[str, ...]:
        """Names of the states that `observe` measures."""
        return self._robot.state_names

    def observe(self) -> FloatArray:
        """Measure the state now, shape (axes, states)."""
        return self._robot.observe()

    def rest(self) -> None:
        """Bring the robot to rest."""
        self._robot.rest()

    def disconnect(self) -> None:
        """Disconnect the robot inside."""
        self._robot.disconnect()
