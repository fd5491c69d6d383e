"""Runs one round of tests on many robots at once, with retries, and says what came of each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from orchestrator.fleet import Fleet
from orchestrator.goal_runner import GoalRunner, Interrupted
from shared.errors import (
    MalformedMessageError,
    NoReplyError,
    RefusedError,
    RobotLostError,
)
from shared.excitation import Excitation
from shared.frequency_response import FrequencyResponse, estimate_frequency_response
from shared.messages import GoalResult, Outcome

ATTEMPTS = 3


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
OnAttempt = Callable[[str, int, str], None]


class Dispatcher:
    """Sends tests to robots; `interrupt` ends a round from another thread with robots at rest."""

    def __init__(self, fleet: Fleet, *, on_attempt_failed: OnAttempt) -> None:
        self._goals = GoalRunner(fleet)
        self._on_attempt_failed = on_attempt_failed

    def run(self, round_id: str, tests: Mapping[str, Excitation]) -> dict[str, TestOutcome]:
        """Run one test on every robot named, all at the same time.

        Args:
            round_id: unique; goal ids are made from it, so that a round sent again is recognised.
            tests: what each robot plays.

        Returns:
            What came of each test, by robot.
        """
        with ThreadPoolExecutor(len(tests), thread_name_prefix="dispatch") as pool:
            futures = {
                robot: pool.submit(self._test, round_id, robot, excitation)
                for robot, excitation in tests.items()
            }
            try:
                return {robot: future.result() for robot, future in futures.items()}
            except BaseException:
                # Ctrl-C, or one robot's test raised what nobody foresaw: no other flies on alone.
                self.interrupt()
                raise

    def interrupt(self) -> None:
        """End the round: cancel every running goal, so that the robots come to rest."""
        self._goals.interrupt()

    def acknowledge_all(self) -> None:
        """Tell every robot that its last results arrived."""
        self._goals.acknowledge_all()

    def _test(self, round_id: str, robot: str, excitation: Excitation) -> TestOutcome:
        reason = ""
        robot_time_s = 0.0
        for attempt in range(1, ATTEMPTS + 1):
            goal_id = f"{round_id}.{robot}.{attempt}"
            try:
                result = self._goals.run(robot, goal_id, excitation)
            except RefusedError as error:
                return Failed(robot, str(error), attempt, robot_time_s)
            except (NoReplyError, RobotLostError, MalformedMessageError) as error:
                reason = str(error)
                self._on_attempt_failed(robot, attempt, reason)
                continue
            robot_time_s += len(result.reference) * result.plan.sample_time_s
            if self._goals.interrupted:
                raise Interrupted
            if result.outcome is not Outcome.COMPLETED:
                reason = f"{result.outcome}: {result.reason}"
            else:
                response = estimate_frequency_response(
                    result.reference, result.response, result.test_plan
                )
                if response.quality.usable:
                    return Measured(robot, response, result, attempt, robot_time_s)
                reason = "; ".join(str(finding) for finding in response.quality.reasons)
                excitation = _longer(excitation, result)
            self._on_attempt_failed(robot, attempt, reason)
        return Failed(robot, reason, ATTEMPTS, robot_time_s)


def _longer(excitation: Excitation, result: GoalResult) -> Excitation:
    """The same test with twice the settling and measuring time, after an unusable response."""
    plan = result.test_plan
    return excitation.model_copy(
        update={
            "settle_s": 2 * max(plan.settle_samples, plan.ramp_samples) * plan.sample_time_s,
            "segment_min_s": 2 * plan.segment_samples * plan.sample_time_s,
        }
    )
