"""Flies references one by one and records the states that a robot measures on the way."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """The record of one flight."""

    references: FloatArray
    """References sent, shape (samples, axes), in the axes' units."""

    states: FloatArray
    """States measured before each reference acted, shape (samples, axes, states)."""


def fly_record(robot: Robot, references: FloatArray) -> FlightRecord:
    """Play references one by one and record every state; the robot ends at rest.

    Args:
        robot: The robot, connected and at rest.
        references: References to play, shape (samples, axes), in the axes' units.

    Returns:
        The record; its states hold the output alone for a robot that observes no states.

    Raises:
        RobotError: The robot failed or measured a number that is not finite; it may be moving.
    """
    states = np.empty((*references.shape, max(1, len(robot.state_names))))
    for k, reference in enumerate(references):
        observed = robot.observe()
        output = robot.step(reference)
        states[k] = observed if observed.shape[1] else output[:, np.newaxis]
        if not np.isfinite(states[k]).all():
            raise RobotError(f"the sensor returned a value that is not finite at sample {k}")
    robot.rest()
    return FlightRecord(references, states)
