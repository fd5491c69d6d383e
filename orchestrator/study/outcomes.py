"""What came of one test of one robot, whatever number of attempts it took."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import GoalResult


@dataclass(frozen=True)
class Measured:
    """A test that gave a usable response, and the samples it came from."""

    robot: str
    response: FrequencyResponse
    result: GoalResult
    attempts: int
    robot_time_s: float


@dataclass(frozen=True)
class Failed:
    """A test that gave none after all its attempts, and why the last one failed."""

    robot: str
    reason: str
    attempts: int
    robot_time_s: float


TestOutcome = Measured | Failed
