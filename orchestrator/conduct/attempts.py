"""Decides what follows the end of an attempt at a test: an outcome, another attempt, or giving up.

The end of every attempt is stored before any further action concerning its robot. This module uses
no network, thread or clock, so that the same code runs in simulations of the whole protocol.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.repository.records import TrialEnd, TrialStatus
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import (
    FrequencyResponse,
    estimate_frequency_response,
)
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.frequency_test.timing import late_findings, timing_findings
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import GoalResult, Outcome

ATTEMPTS = 3
"""Number of failed attempts after which a robot is given up in a round."""

ATTEMPTS_IN_ALL = 50
"""Limit on attempts of any kind, including those interrupted through no fault of the robot."""

CANCELLED = "cancelled"
"""Code of the refusal of a goal whose cancellation arrived before the goal itself."""

_LENGTHEN = 2.0
"""Factor by which a test is lengthened when its response was not usable."""

_LENGTHEN_STEPS = 8
"""Number of factors to try, from the full one down in equal ratios, until the test is accepted."""

Estimate = Callable[[GoalResult], FrequencyResponse]


class Log(Protocol):
    """Storage of attempts, as `TrialLog` implements it; `ended` may raise RepositoryError."""

    @property
    def study_id(self) -> str:
        """Id of the study to which the attempts belong."""

    def ended(self, test: OpenTest, end: TrialEnd) -> None:
        """Store how an attempt ended, with the data that it gave."""


@dataclass(frozen=True)
class Settled:
    """The decision about an ended attempt: an outcome, another attempt, or neither.

    There is neither when the round was interrupted.
    """

    outcome: TestOutcome | None = None
    """Final outcome of the test; None when it is not decided."""
    following: OpenTest | None = None
    """Next attempt to be sent; None when there is none."""
    failure: str | None = None
    """Reason why this attempt gave no usable response.

    None when it gave one, when the robot refused it, and when the interruption of the round
    leaves it undecided.
    """


def estimated(result: GoalResult) -> FrequencyResponse:
    """Return the frequency response estimated from the samples of a complete test."""
    plan = result.test_plan
    response = estimate_frequency_response(result.reference, result.response, plan)
    found = [*late_findings(result.late_samples, plan.samples)]
    if result.timing is not None:
        response = response.delayed(result.timing.clock_std_s)
        found += timing_findings(result.timing, plan.sample_time_s)
    if not found:
        return response
    warnings = (*response.quality.warnings, *found)
    quality = response.quality.model_copy(update={"warnings": warnings})
    return replace(response, quality=quality)


def share_delay(specs: Iterable[RobotSpec]) -> bool:
    """Return whether all robots are measured through the same chain.

    They share its delay, so that their distances do not depend on it; otherwise the variance of
    each response has to include what is unknown of its own (`FrequencyResponse.delayed`).

    Args:
        specs: Specs of the robots that are compared.
    """
    return len({spec.measurement for spec in specs}) == 1


def without_the_expected(response: FrequencyResponse, spec: RobotSpec) -> FrequencyResponse:
    """Return a response without the warning that its robot rang for as long as its spec says.

    Tests may wait for less than that, since what still rings is estimated along with the tones.

    Args:
        response: Estimated response.
        spec: Spec of the robot.
    """
    before = response.quality.warnings
    warnings = tuple(
        one
        for one in before
        if one.code != "ringing" or (one.value or math.inf) > spec.settling_time_s
    )
    if len(warnings) == len(before):
        return response
    return replace(response, quality=response.quality.model_copy(update={"warnings": warnings}))


class Attempts:
    """The attempts of one round of tests; threads may use it at once for different robots."""

    def __init__(
        self, log: Log, specs: Mapping[str, RobotSpec], *, estimate: Estimate = estimated
    ) -> None:
        """Begin a round.

        Args:
            log: Storage for the end of every attempt.
            specs: Spec of each robot in the round, by name.
            estimate: Function that estimates a response from the result of a complete test.
        """
        self._log = log
        self._specs = specs
        self._share_delay = share_delay(specs.values())
        self._estimate = estimate
        self._robot_time_s: dict[str, float] = {}

    def settle(self, test: OpenTest, ended: Ended, *, interrupted: bool) -> Settled:
        """Store how an attempt ended, and decide what follows.

        Args:
            test: The attempt that ended.
            ended: The way in which it ended.
            interrupted: Whether the round is to end without further attempts.

        Returns:
            The outcome of the test or its next attempt; neither when the round is interrupted.

        Raises:
            RepositoryError: The end could not be stored.
        """
        if ended.interrupted and ended.result is None:
            # The result is unknown, not lost: resuming the study asks the robot for it again.
            return Settled()
        if ended.result is not None:
            settled = self._settle_result(test, ended.result, interrupted)
        elif isinstance(ended.error, RefusedError) and ended.error.code != CANCELLED:
            reason = str(ended.error)
            self._log.ended(test, TrialEnd(TrialStatus.FAILED, reason))
            settled = Settled(outcome=self._failed(test, reason))
        else:
            # If the previous orchestrator was killed, its goal may have been cancelled before it
            # arrived, or the fleet it had started may have died with it. Neither is a failure of
            # the robot.
            excuse = isinstance(ended.error, RefusedError) or test.accepted_by is not None
            retry = _retry(test, test.excitation, excuse)
            settled = self._followed(
                test, TrialEnd(TrialStatus.LOST, str(ended.error), retry, excuse)
            )
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
            spec = self._specs[test.robot]
            response = self._estimate(result)
            if not self._share_delay:
                response = response.delayed(spec.delay_uncertainty_s)
            response = without_the_expected(response, spec)
            if response.quality.usable:
                end = TrialEnd(TrialStatus.MEASURED, result=result, response=response)
                self._log.ended(test, end)
                return Settled(Measured(test.robot, response, result, test.attempt, total_s))
            reason = "; ".join(str(finding) for finding in response.quality.reasons)
            played = retried(test.excitation, result.test_plan, response.quality, spec)
            retry = _retry(test, played)
        return self._followed(
            test, TrialEnd(TrialStatus.FAILED, reason, retry, excuse, result, response)
        )

    def _followed(self, test: OpenTest, end: TrialEnd) -> Settled:
        """Store an end without a usable response, and return the next attempt if there is one."""
        self._log.ended(test, end)
        if end.retry is None:
            return Settled(outcome=self._failed(test, end.reason), failure=end.reason)
        following = test.followed_by(self._log.study_id, end.retry, interrupted=end.interrupted)
        return Settled(following=following, failure=end.reason)

    def _failed(self, test: OpenTest, reason: str) -> Failed:
        flown_s = self._robot_time_s.get(test.robot, 0.0)
        return Failed(test.robot, reason, test.attempt, flown_s)


def _excuse(test: OpenTest, result: GoalResult, interrupted: bool) -> bool:
    """Return whether a motion ended early for a reason that is no failure of its robot."""
    if result.outcome is Outcome.ABORTED:
        # The robot lost contact with its orchestrator, or was stopped by someone else.
        return True
    if result.outcome in (Outcome.CANCELLED, Outcome.LOST):
        # Excused only where the motion ended with its orchestrator, this one or an earlier one. An
        # agent that died on its own may do so again, so that counts against the robot.
        return interrupted or test.record is not None
    return False


def _retry(test: OpenTest, excitation: Excitation, excuse: bool = False) -> Excitation | None:
    """Return the excitation of the next attempt; None once either limit on attempts is reached."""
    failures = test.failures + (not excuse)
    given_up = failures >= ATTEMPTS or test.attempt >= ATTEMPTS_IN_ALL
    return None if given_up else excitation


def retried(
    excitation: Excitation, plan: ExcitationPlan, quality: Quality, spec: RobotSpec
) -> Excitation:
    """Return what a robot plays after a test that was not usable.

    What saturated is played at half the amplitude. Everything else is played for up to twice as
    long. If noise hid the response at all tones, only the lower half of them is played. Where the
    robot chooses the amplitude, that is several times as large, since fast tones are limited the
    most; one that was asked for stays as it is, as it may be the largest that anyone wants.

    Args:
        excitation: Excitation of the completed test.
        plan: Plan that the robot executed.
        quality: Verdict on the test.
        spec: Spec of the robot, which limits the duration of a test.

    Returns:
        The next excitation; the longest that the robot accepts, which may be as long as before.
    """
    codes = {reason.code for reason in quality.reasons}
    if "clipped" in codes:
        return _at_amplitudes(excitation, [played.amplitude / 2 for played in plan.played])
    if "uncertain" in codes:
        excitation = _lower_half(excitation)
    settle_s = max(plan.settle_samples, plan.ramp_samples) * plan.sample_time_s
    segment_s = plan.segment_samples * plan.sample_time_s
    for step in range(_LENGTHEN_STEPS):
        # 2, 2^(7/8), ... 2^(1/8): the first that fits is the longest.
        factor = _LENGTHEN ** (1 - step / _LENGTHEN_STEPS)
        longer = excitation.model_copy(
            update={"settle_s": factor * settle_s, "segment_min_s": factor * segment_s}
        )
        if duration_s(longer, spec) <= spec.duration_max_s:
            return longer
    return excitation


def _lower_half(excitation: Excitation) -> Excitation:
    """Return an excitation with the lower half of each axis's tones, but no fewer than two."""
    halves = []
    for one in excitation.played:
        tones = sorted(one.tones, key=lambda tone: tone.omega_rad_s)
        halves.append({"tones": tuple(tones[: max(len(tones) // 2, 2)])})
    first, *others = halves
    also = tuple(
        one.model_copy(update=half) for one, half in zip(excitation.also, others, strict=True)
    )
    return excitation.model_copy(update={**first, "also": also})


def _at_amplitudes(excitation: Excitation, amplitudes: Sequence[float]) -> Excitation:
    """Return an excitation whose axes have other amplitudes, in the order of its axes."""
    first, *others = amplitudes
    also = tuple(
        one.model_copy(update={"amplitude": amplitude})
        for one, amplitude in zip(excitation.also, others, strict=True)
    )
    return excitation.model_copy(update={"amplitude": first, "also": also})
