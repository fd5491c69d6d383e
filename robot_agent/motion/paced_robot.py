"""A robot whose samples keep time, and whose motion can be ended before each of them."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nufleet.robot_agent.motion.pace import HaltSwitch, Pace
from nufleet.robot_agent.robot import Robot, RobotAround
from nufleet.shared.arrays import FloatArray


def play(robot: Robot, references: FloatArray) -> FloatArray:
    """Play one batch of `Pace.batches`; references and outputs have shape (samples, axes).

    A batch of one sample is a step, for only steps are watched for being late.
    """
    if len(references) > 1:
        return robot.run(references)
    return robot.step(references[0])[np.newaxis]


def play_observed(
    robot: Robot, references: FloatArray, observed: Sequence[int]
) -> tuple[FloatArray, FloatArray]:
    """Play one batch as `play` does, and observe the states as `Robot.run_observed` does."""
    if len(references) > 1:
        return robot.run_observed(references, observed)
    states = [robot.observe() for _ in observed]
    return play(robot, references), np.array(states)


class Halted(Exception):  # noqa: N818 - not an error: the end was requested
    """The switch was thrown before the next sample."""


class PacedRobot(RobotAround):
    """Passes every call of one motion on to a robot, in time, until the switch is thrown."""

    def __init__(
        self, robot: Robot, pace: Pace, switch: HaltSwitch, on_played: Callable[[int], None]
    ) -> None:
        """Prepare for one motion.

        Args:
            robot: The robot, connected and at rest.
            pace: Timing of the motion's samples.
            switch: Switch of the motion; once it is thrown, `step` and `run` raise `Halted`.
            on_played: Callback that receives the number of samples played until now.
        """
        super().__init__(robot)
        self._pace, self._switch = pace, switch
        self._on_played = on_played
        self._played = 0

    def connect(self) -> None:
        """Do nothing: the robot is connected already."""

    def step(self, reference: FloatArray) -> FloatArray:
        """Follow a reference for one sample when it is due; both have shape (axes,)."""
        self._pace.wait()
        self._raise_if_halted()
        output = self._robot.step(reference)
        self._count(1)
        return output

    def run(self, references: FloatArray) -> FloatArray:
        """Follow a whole reference signal; references and outputs have shape (samples, axes)."""
        outputs = np.empty_like(references)
        for batch in self._pace.batches(len(references)):
            self._raise_if_halted()
            outputs[batch] = play(self._robot, references[batch])
            self._count(batch.stop - batch.start)
        return outputs

    def disconnect(self) -> None:
        """Do nothing: the robot stays connected until the motion worker releases it."""

    def _raise_if_halted(self) -> None:
        if self._switch.order is not None:
            raise Halted

    def _count(self, samples: int) -> None:
        self._played += samples
        self._on_played(self._played)
