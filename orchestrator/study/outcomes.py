"""The outcome of one test of one robot, after all its attempts."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import GoalResult


@dataclass(frozen=True)
class Measured:
    """A test that gave a usable response."""

    robot: str
    """Name of the robot under test."""
    response: FrequencyResponse
    """Estimated frequency response."""
    result: GoalResult
    """Result of the successful attempt, with the samples behind the response."""
    attempts: int
    """Number of attempts that the test took."""
    robot_time_s: float
    """Time that the robot moved in all attempts, in s."""


@dataclass(frozen=True)
class Failed:
    """A test that gave no usable response in any attempt."""

    robot: str
    """Name of the robot under test."""
    reason: str
    """Reason why the last attempt failed."""
    attempts: int
    """Number of attempts that were made."""
    robot_time_s: float
    """Time that the robot moved in all attempts, in s."""


TestOutcome = Measured | Failed
