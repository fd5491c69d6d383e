"""A robot whose motion ends when its measured output cannot be the answer to its references."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.motion.monitor import Monitor, rest_failure, rest_measurements
from nufleet.robot_agent.robot import Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError


class MonitoredRobot(RobotAround):
    """Passes every call on to a robot and checks the samples of one motion, from rest to rest.

    `noise_std` is the standard deviation of the output at rest, shape (axes,), in the axes' units;
    it is zero before `begin_motion`.
    """

    def __init__(self, robot: Robot) -> None:
        """Prepare for one motion of a robot that is connected and at rest."""
        super().__init__(robot)
        self._monitor: Monitor | None = None
        self._failed: RobotError | None = None
        self.noise_std = np.zeros(len(robot.spec.axes))

    def begin_motion(self, references: FloatArray) -> None:
        """Compare where the robot rests with where its motion begins.

        To be called before the first sample.

        Args:
            references: References of the motion as far as they are known ahead, shape (samples,
                axes), in the axes' units.

        Raises:
            RobotError: The robot rests too far from the first reference, or its sensor fails.
        """
        measured, self._monitor = begun(self._robot, references, flight=True)
        self.noise_std = measured.std(axis=0, ddof=1)

    def connect(self) -> None:
        """Do nothing: the robot is connected already."""

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample; reference and output have shape (axes,).

        Raises:
            RobotError: The sensor or the robot fails.
        """
        output = self._robot.step(reference)
        self._check(reference[np.newaxis], output[np.newaxis])
        return output

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a reference signal; references and outputs have shape (samples, axes).

        Raises:
            RobotError: The sensor or the robot fails.
        """
        outputs = self._robot.run(references)
        if len(references):
            self._check(references, outputs)
        return outputs

    def raise_again(self) -> None:
        """Raise the error that the monitor raised before, if it did and a caller caught it."""
        if self._failed is not None:
            raise self._failed

    def disconnect(self) -> None:
        """Do nothing: the robot stays connected until the motion worker releases it."""

    def _check(self, references: FloatArray, outputs: FloatArray) -> None:
        if self._monitor is None:
            raise RuntimeError("a motion has to begin before its first sample")
        failure = self._monitor.check(references, outputs)
        if failure is not None:
            self._failed = failure.error
            raise self._failed


def begun(robot: Robot, references: FloatArray, *, flight: bool) -> tuple[FloatArray, Monitor]:
    """Measure a robot at rest and prepare to watch its motion from there.

    Args:
        robot: The robot, connected and at rest.
        references: References of the motion as far as they are known ahead, shape (samples, axes),
            in the axes' units.
        flight: Whether the output should stay close to the references; see `Monitor`.

    Returns:
        The outputs measured at rest, shape (measurements, axes), and the monitor of the motion.

    Raises:
        RobotError: The robot rests too far from the first reference, or its sensor fails.
    """
    spec = robot.spec
    measured = np.stack([robot.measure_output() for _ in range(rest_measurements(spec))])
    failure = rest_failure(spec, measured, references[0])
    if failure is not None:
        raise RobotError(failure)
    return measured, Monitor(spec, measured, np.ptp(references, axis=0), flight=flight)
