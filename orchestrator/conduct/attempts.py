"""What follows from the end of an attempt at a test: an answer, another attempt, or giving up.

Every end is stored before anything else is done about its robot. There is no network here, no
thread and no clock, so that the same code runs in simulations of the whole protocol.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Protocol

from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import GoalAccepted, GoalResult, Outcome

ATTEMPTS = 3
"""Failed attempts after which a robot is given up in a round."""

ATTEMPTS_IN_ALL = 50
"""And attempts that ended for whatever reason, also one that is nobody's failure."""

CANCELLED = "cancelled"
"""The refusal of a goal that was cancelled before it came."""

_LENGTHEN = 2.0
"""How much longer a test is repeated whose response was not usable."""

_LENGTHEN_STEPS = 8

Estimate = Callable[[GoalResult], FrequencyResponse]


class Log(Protocol):
    """Where attempts are stored, as `TrialLog` does it; every method may raise RepositoryError."""

    @property
    def study_id(self) -> str:
        """The study whose attempts they are."""

    def accepted(self, test: OpenTest, accepted: GoalAccepted) -> None:
        """Store that its robot has taken a test."""

    def measured(self, test: OpenTest, result: GoalResult, response: FrequencyResponse) -> None:
        """Store a usable response."""

    def failed(
        self,
        test: OpenTest,
        reason: str,
        *,
        retry: Excitation | None,
        interrupted: bool = False,
        result: GoalResult | None = None,
        response: FrequencyResponse | None = None,
    ) -> None:
        """Store that an attempt gave nothing usable."""

    def lost(
        self, test: OpenTest, reason: str, *, retry: Excitation | None, interrupted: bool
    ) -> None:
        """Store that nobody will know what came of an attempt."""


@dataclass(frozen=True)
class Settled:
    """What follows from an attempt: an `outcome`, or the `following` attempt, or neither.

    Neither is what an interrupted round leaves. `failure` is why this attempt gave no usable
    response; None when it did, and when it says nothing about the robot.
    """

    outcome: TestOutcome | None = None
    following: OpenTest | None = None
    failure: str | None = None


def estimated(result: GoalResult) -> FrequencyResponse:
    """Return the response that a complete test shows."""
    return estimate_frequency_response(result.reference, result.response, result.test_plan)


class Attempts:
    """The attempts of one round of tests; may be used from many threads, for different robots."""

    def __init__(
        self, log: Log, specs: Mapping[str, RobotSpec], *, estimate: Estimate = estimated
    ) -> None:
        """Begin a round.

        Args:
            log: where the end of every attempt is stored.
            specs: what each robot of the round says of itself.
            estimate: makes a response of the samples of a complete test.
        """
        self._log = log
        self._specs = specs
        self._estimate = estimate
        self._robot_time_s: dict[str, float] = {}

    def settle(self, test: OpenTest, ended: Ended, *, interrupted: bool) -> Settled:
        """Store how an attempt ended, and say what follows.

        Args:
            test: the attempt.
            ended: how it ended.
            interrupted: whether the round is to end without further attempts.

        Raises:
            RepositoryError: it could not be stored.
        """
        if ended.interrupted and ended.result is None:
            # Nothing is known of it; who resumes the study asks its robot again.
            return Settled()
        if ended.result is not None:
            settled = self._settle_result(test, ended.result, interrupted)
        elif isinstance(ended.error, RefusedError) and ended.error.code != CANCELLED:
            reason = str(ended.error)
            self._log.failed(test, reason, retry=None)
            settled = Settled(outcome=self._failed(test, reason))
        else:
            # An earlier orchestrator's goal may have gone with it: cancelled before it came, or
            # with the whole fleet that was its own.
            excuse = isinstance(ended.error, RefusedError) or test.accepted_by is not None
            settled = self._settle_loss(test, str(ended.error), excuse)
        if interrupted and not isinstance(settled.outcome, Measured):
            return Settled()
        return settled

    def _settle_result(self, test: OpenTest, result: GoalResult, interrupted: bool) -> Settled:
        flown_s = len(result.reference) * result.plan.sample_time_s
        total_s = self._robot_time_s[test.robot] = self._robot_time_s.get(test.robot, 0.0) + flown_s
        response = None
        excuse = _excuse(test, result, interrupted)
        if result.outcome is not Outcome.COMPLETED:
            reason = f"{result.outcome}: {result.reason}"
            retry = _retry(test, test.excitation, excuse)
        else:
            response = self._estimate(result)
            if response.quality.usable:
                self._log.measured(test, result, response)
                return Settled(Measured(test.robot, response, result, test.attempt, total_s))
            reason = "; ".join(str(finding) for finding in response.quality.reasons)
            retry = _retry(test, lengthened(test.excitation, result, self._specs[test.robot]))
        self._log.failed(
            test, reason, retry=retry, interrupted=excuse, result=result, response=response
        )
        return self._followed(test, reason, retry, excuse)

    def _settle_loss(self, test: OpenTest, reason: str, excuse: bool) -> Settled:
        retry = _retry(test, test.excitation, excuse)
        self._log.lost(test, reason, retry=retry, interrupted=excuse)
        return self._followed(test, reason, retry, excuse)

    def _followed(
        self, test: OpenTest, reason: str, retry: Excitation | None, excuse: bool
    ) -> Settled:
        if retry is None:
            return Settled(outcome=self._failed(test, reason), failure=reason)
        following = test.followed_by(self._log.study_id, retry, interrupted=excuse)
        return Settled(following=following, failure=reason)

    def _failed(self, test: OpenTest, reason: str) -> Failed:
        flown_s = self._robot_time_s.get(test.robot, 0.0)
        return Failed(test.robot, reason, test.attempt, flown_s)


def _excuse(test: OpenTest, result: GoalResult, interrupted: bool) -> bool:
    """Return whether a motion ended early for a reason that says nothing against its robot."""
    if result.outcome is Outcome.ABORTED:
        # Cut off from its orchestrator, or told to end by somebody else.
        return True
    if result.outcome in (Outcome.CANCELLED, Outcome.LOST):
        # With its orchestrator. One whose agent died by itself may do so again.
        return interrupted or test.record is not None
    return False


def _retry(test: OpenTest, excitation: Excitation, excuse: bool = False) -> Excitation | None:
    """Return what is played after an attempt failed; None when there were enough of them."""
    failures = test.failures + (not excuse)
    given_up = failures >= ATTEMPTS or test.attempt >= ATTEMPTS_IN_ALL
    return None if given_up else excitation


def lengthened(excitation: Excitation, result: GoalResult, spec: RobotSpec) -> Excitation:
    """Return a test with up to twice the settling and measuring time of one that was played.

    It lasts at most as long as the robot accepts; where nothing longer fits, it is the same test.
    """
    plan = result.test_plan
    settle_s = max(plan.settle_samples, plan.ramp_samples) * plan.sample_time_s
    segment_s = plan.segment_samples * plan.sample_time_s
    for step in range(_LENGTHEN_STEPS):
        factor = _LENGTHEN ** (1 - step / _LENGTHEN_STEPS)
        longer = excitation.model_copy(
            update={"settle_s": factor * settle_s, "segment_min_s": factor * segment_s}
        )
        if duration_s(longer, spec) <= spec.duration_max_s:
            return longer
    return excitation
