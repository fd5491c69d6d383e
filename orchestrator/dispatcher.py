"""Runs one round of tests on many robots at once, with retries, and says what came of each."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial

from orchestrator.fleet import Fleet
from orchestrator.goal_runner import GoalRunner, Interrupted
from orchestrator.resume import OpenTest
from orchestrator.trial_log import TrialLog
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
"""Failed attempts after which a robot is given up in a round."""

ATTEMPTS_IN_ALL = 50
"""And attempts that ended for whatever reason, also one that is nobody's failure."""


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
    """Sends tests to robots; `interrupt` ends a round from another thread with robots at rest.

    What is sent is stored before, what comes of it before anything else is sent to that robot.
    """

    def __init__(self, fleet: Fleet, log: TrialLog, *, on_attempt_failed: OnAttempt) -> None:
        self._goals = GoalRunner(fleet)
        self._log = log
        self._on_attempt_failed = on_attempt_failed

    def run(self, tests: Sequence[OpenTest]) -> dict[str, TestOutcome]:
        """Run one test on every robot named, all at the same time.

        Args:
            tests: of different robots. One that an earlier orchestrator sent already is sent again
                under its id, so that it stays one motion.

        Returns:
            What came of each test, by robot.

        Raises:
            Interrupted: `interrupt` was called.
            RepositoryError: something could not be stored; every robot is at rest.
        """
        self._log.intend(tests)
        with ThreadPoolExecutor(len(tests), thread_name_prefix="dispatch") as pool:
            futures = {test.robot: pool.submit(self._test, test) for test in tests}
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

    def _test(self, test: OpenTest) -> TestOutcome:
        robot_time_s = 0.0
        while True:
            ended: Measured | _Unusable
            try:
                result = self._play(test)
                robot_time_s += len(result.reference) * result.plan.sample_time_s
                ended = self._judge(test, result, robot_time_s)
            except RefusedError as error:
                self._log.failed(test, str(error), retry=None)
                return Failed(test.robot, str(error), test.attempt, robot_time_s)
            except (NoReplyError, RobotLostError, MalformedMessageError) as error:
                ended = self._lose(test, str(error))
            if self._goals.interrupted:
                raise Interrupted
            if isinstance(ended, Measured):
                return ended
            self._on_attempt_failed(test.robot, test.attempt, ended.reason)
            if ended.retry is None:
                return Failed(test.robot, ended.reason, test.attempt, robot_time_s)
            test = test.followed_by(self._log.study_id, ended.retry, interrupted=ended.interrupted)
            self._log.intend([test])

    def _play(self, test: OpenTest) -> GoalResult:
        """Have a test played, or fetch its result when it was played already."""
        robot, goal_id = test.robot, test.goal_id
        if test.accepted_by is None or test.may_be_sent_to(self._goals.boot_id(robot)):
            return self._goals.run(
                robot, goal_id, test.excitation, on_accepted=partial(self._log.accepted, test)
            )
        try:
            return self._goals.result(robot, goal_id)
        except RefusedError as error:
            raise RobotLostError(
                f"the agent of {robot} restarted after it took {goal_id}: {error.reason}"
            ) from error

    def _judge(
        self, test: OpenTest, result: GoalResult, robot_time_s: float
    ) -> Measured | _Unusable:
        """Store what a robot returned; return what was measured, or why nothing was."""
        if result.outcome is not Outcome.COMPLETED:
            interrupted = self._was_interrupted(test, result)
            reason = f"{result.outcome}: {result.reason}"
            ended = _Unusable(reason, _retry(test, test.excitation, interrupted), interrupted)
            response = None
        else:
            response = estimate_frequency_response(
                result.reference, result.response, result.test_plan
            )
            if response.quality.usable:
                self._log.measured(test, result, response)
                return Measured(test.robot, response, result, test.attempt, robot_time_s)
            reason = "; ".join(str(finding) for finding in response.quality.reasons)
            ended = _Unusable(reason, _retry(test, _longer(test.excitation, result)))
        self._log.failed(
            test,
            ended.reason,
            retry=ended.retry,
            interrupted=ended.interrupted,
            result=result,
            response=response,
        )
        return ended

    def _was_interrupted(self, test: OpenTest, result: GoalResult) -> bool:
        """Whether a motion ended for a reason that says nothing against its robot."""
        if result.outcome not in (Outcome.ABORTED, Outcome.CANCELLED):
            return False
        if test.record is not None or self._goals.interrupted:
            # A robot whose orchestrator went away ends what it plays.
            return True
        # So does one that was cut off from its orchestrator, or told to end by somebody else. But
        # one whose agent died during a test may do so again.
        return (
            result.outcome is Outcome.ABORTED and self._goals.boot_id(test.robot) == result.boot_id
        )

    def _lose(self, test: OpenTest, reason: str) -> _Unusable:
        """Store that nobody will know what came of a test."""
        # With an orchestrator that was killed its own fleet may have gone, too.
        interrupted = test.accepted_by is not None
        ended = _Unusable(reason, _retry(test, test.excitation, interrupted), interrupted)
        self._log.lost(test, reason, retry=ended.retry, interrupted=interrupted)
        return ended


@dataclass(frozen=True)
class _Unusable:
    """An attempt without a usable response, and what its robot plays next; None gives it up."""

    reason: str
    retry: Excitation | None
    interrupted: bool = False


def _retry(test: OpenTest, excitation: Excitation, interrupted: bool = False) -> Excitation | None:
    """Return what is played after an attempt failed; None when there were enough of them."""
    failures = test.failures + (not interrupted)
    given_up = failures >= ATTEMPTS or test.attempt >= ATTEMPTS_IN_ALL
    return None if given_up else excitation


def _longer(excitation: Excitation, result: GoalResult) -> Excitation:
    """The same test with twice the settling and measuring time, after an unusable response."""
    plan = result.test_plan
    return excitation.model_copy(
        update={
            "settle_s": 2 * max(plan.settle_samples, plan.ramp_samples) * plan.sample_time_s,
            "segment_min_s": 2 * plan.segment_samples * plan.sample_time_s,
        }
    )
