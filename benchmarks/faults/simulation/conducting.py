"""How a simulated orchestrator conducts its study: goals, attempts, and what it must never do."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from benchmarks.faults.simulation.history import Violation
from benchmarks.faults.simulation.network import NoAnswer
from benchmarks.faults.simulation.repository import SimulatedLog, SimulatedRepository
from benchmarks.faults.simulation.robot import BAD_SENSOR
from benchmarks.faults.simulation.study import RankingStudy, response_of, useless
from nufleet.orchestrator.conduct.attempts import ATTEMPTS, ATTEMPTS_IN_ALL, Attempts, Settled
from nufleet.orchestrator.conduct.replay import OpenRound, OpenTest, resume, round_of
from nufleet.orchestrator.fleet.goal_events import (
    Accepted,
    Ask,
    CancelTaken,
    Ended,
    Event,
    Fetched,
    InterruptAsked,
    Passed,
    Question,
    Refused,
    Sighting,
    Unanswered,
)
from nufleet.orchestrator.fleet.goal_pursuit import RETURN_PATIENCE_S, Pursuit
from nufleet.orchestrator.fleet.requests import QUERY_TIMEOUT_S, RESULT_TIMEOUT_S
from nufleet.orchestrator.repository.errors import RepositoryError
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.shared.errors import NoReplyError, RefusedError, StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import (
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Refusal,
)

if TYPE_CHECKING:
    from benchmarks.faults.simulation.orchestrator import SimulatedOrchestrator


@dataclass(eq=False)
class Run:
    """One test of one robot in progress."""

    test: OpenTest
    """Test of the study."""

    pursuit: Pursuit
    """State machine that pursues the test's goal."""

    request: GoalRequest
    """Request that submits the goal."""

    stored: bool = False
    """Whether the goal's acceptance is stored."""

    wakes_s: float = math.inf
    """Time at which the pursuit wakes next."""


class Conduct:
    """The study of one orchestrator process, from its first round to its end."""

    def __init__(
        self, process: SimulatedOrchestrator, repository: SimulatedRepository, study_id: str
    ) -> None:
        """Prepare to conduct a study.

        Args:
            process: The process that conducts it; told how the study ends.
            repository: Repository that keeps the study's trials.
            study_id: Id of the study there.
        """
        self.ranking: tuple[str, ...] = ()
        self.dropped: dict[str, str] = {}
        self._process, self._repository, self._study_id = process, repository, study_id
        self._epochs: Mapping[str, int] = {}
        self._runs: dict[str, Run] = {}
        self._abandoned: dict[str, tuple[str, ...]] = {}
        self._round: OpenRound | None = None
        self._outcomes: dict[str, TestOutcome] = {}
        self._study: RankingStudy
        self._attempts: Attempts
        self._log: SimulatedLog

    @property
    def idle(self) -> bool:
        """Whether no goal is pursued."""
        return not self._runs

    @property
    def abandoned(self) -> frozenset[str]:
        """Robots that may still pursue goals that this orchestrator gave up."""
        return frozenset(self._abandoned)

    def interrupt(self) -> None:
        """Interrupt every goal in progress at once."""
        for run in tuple(self._runs.values()):
            self._take(run, InterruptAsked())

    def take(self, robot: str, event: Event) -> None:
        """Pass an event on to the goal that a robot pursues, if there is one."""
        run = self._runs.get(robot)
        if run is not None:
            self._take(run, event)

    def begin(self, epochs: Mapping[str, int]) -> None:
        """Begin the study, or resume it from the content of the repository."""
        self._epochs = epochs
        self._log = SimulatedLog(self._repository, self._study_id, epochs)
        self._study = RankingStudy(tuple(self._process.robots))
        trials = tuple(self._repository.trials.values())
        try:
            at = resume(self._study_id, self._study, trials)
        except StudyError as error:
            self._process.end(f"failed: {error}")
            return
        self._go_on(at.open)

    def _go_on(self, at: OpenRound | None) -> None:
        if at is None:
            self.ranking = self._study.ranking
            self.dropped = dict(self._study.dropped)
            self._process.end("complete")
            return
        self._round, self._outcomes = at, {}
        try:
            self._log.intend(at.tests)
        except RepositoryError as error:
            self._process.fail(error)
            return
        specs = {name: robot.spec for name, robot in self._process.robots.items()}
        self._attempts = Attempts(self._log, specs, estimate=_estimate)
        for test in at.tests:
            self._pursue(test)
        self._process.end_if_idle()

    def _pursue(self, test: OpenTest) -> None:
        if self._process.interrupted:
            return
        sight = self._process.sights[test.robot]
        request = GoalRequest(
            goal_id=test.goal_id,
            owner=self._process.name,
            epoch=self._epochs[test.robot],
            motion=test.excitation,
        )
        pursuit = Pursuit(
            test.robot,
            test.goal_id,
            Sighting(sight.alive, sight.heard_s),
            self._process.world.now_s,
            taken_before=test.accepted_by is not None,
            abandoned=self._abandoned.get(test.robot, ()),
        )
        run = self._runs[test.robot] = Run(test, pursuit, request)
        self._take(run, Passed())

    def _take(self, run: Run, event: Event) -> None:
        if self._runs.get(run.test.robot) is not run:
            return
        now_s = self._process.world.now_s
        asks = run.pursuit.take(event, now_s)
        accepted = run.pursuit.accepted
        if accepted is not None and not run.stored:
            run.stored = True
            try:
                self._log.accepted(run.test, accepted)
            except RepositoryError as error:
                self._send(run, asks)
                self._process.fail(error)
                return
        self._send(run, asks)
        if run.pursuit.ended is not None:
            self._ended(run, run.pursuit.ended)
        elif run.pursuit.wake_s < run.wakes_s:
            self._wake_at(run, run.pursuit.wake_s)

    def _wake_at(self, run: Run, time_s: float) -> None:
        run.wakes_s = time_s

        def wake() -> None:
            if run.wakes_s != time_s or self._runs.get(run.test.robot) is not run:
                return
            run.wakes_s = math.inf
            self._take(run, Passed())

        self._process.world.at(time_s, lambda: self._process.node.do(wake))

    def _send(self, run: Run, asks: tuple[Ask, ...]) -> None:
        for ask in asks:
            epoch = run.request.epoch
            bodies = {
                Question.GOAL: run.request,
                Question.RESULT: ask.goal_id,
                Question.CANCEL: (ask.goal_id, Commander(self._process.name, epoch)),
            }
            timeout_s = RESULT_TIMEOUT_S if ask.question is Question.RESULT else QUERY_TIMEOUT_S
            self._process.ask(
                run.test.robot,
                ask.question,
                bodies[ask.question],
                timeout_s,
                lambda answer, ask=ask: self._answered(run, ask, answer),
            )

    def _answered(self, run: Run, ask: Ask, answer: Any) -> None:
        if self._process.over is not None:
            return
        robot = run.test.robot
        if not isinstance(answer, NoAnswer):
            self._process.sights[robot].heard_s = self._process.world.now_s
        self._take(run, _event(robot, ask, answer))

    def _ended(self, run: Run, ended: Ended) -> None:
        robot, now_s = run.test.robot, self._process.world.now_s
        if ended.result is None:
            self._process.history.tell(now_s, f"{run.test.goal_id} ends without a result: {ended}")
            self._check_given_up(run, ended)
        del self._runs[robot]
        self._abandoned.pop(robot, None)
        if ended.abandoned:
            self._abandoned[robot] = ended.abandoned
        try:
            settled = self._attempts.settle(run.test, ended, interrupted=self._process.interrupted)
            if settled.following is not None and not self._process.interrupted:
                self._log.intend([settled.following])
        except RepositoryError as error:
            self._process.fail(error)
            self._process.end_if_idle()
            return
        if self._process.interrupted:
            self._process.end_if_idle()
            return
        if settled.following is not None:
            self._pursue(settled.following)
            return
        self._conclude(run, settled, ended)

    def _conclude(self, run: Run, settled: Settled, ended: Ended) -> None:
        outcome, at = settled.outcome, self._round
        if outcome is None or at is None:
            raise Violation(f"nothing follows from {run.test.goal_id}: {ended}")
        self._outcomes[run.test.robot] = outcome
        if isinstance(outcome, Failed):
            self._check_failed(run, outcome, ended)
        if len(self._outcomes) == len(at.tests):
            self._tell(at)

    def _tell(self, at: OpenRound) -> None:
        responses: dict[str, FrequencyResponse] = {}
        failed: dict[str, str] = {}
        for robot, trial in at.answers.items():
            if trial.status is TrialStatus.MEASURED and trial.response is not None:
                responses[robot] = trial.response
            else:
                failed[robot] = trial.reason
        for robot, known in self._outcomes.items():
            if isinstance(known, Measured):
                responses[robot] = known.response
            else:
                failed[robot] = known.reason
        try:
            self._study.tell(responses, failed)
        except StudyError as error:
            self.dropped = dict(failed)
            self._process.end(f"failed: {error}")
            return
        question = self._study.ask()
        self._go_on(None if question is None else round_of(self._study_id, question))

    # Checks of the promises.

    def _check_given_up(self, run: Run, ended: Ended) -> None:
        if isinstance(ended.error, RefusedError) or ended.error is None:
            return
        silent_s = self._process.world.now_s - self._process.sights[run.test.robot].heard_s
        patient = isinstance(ended.error, NoReplyError)  # unanswered for ANSWER_PATIENCE_S
        if silent_s < RETURN_PATIENCE_S - 1e-6 and not patient and _is_loss(ended):
            raise Violation(
                f"{self._process.world.now_s:.3f}: {run.test.robot} is given up for "
                f"{run.test.goal_id}, and was heard {silent_s:.3f} s ago: {ended.error}"
            )

    def _check_failed(self, run: Run, outcome: Failed, ended: Ended) -> None:
        test = run.test
        if isinstance(ended.error, RefusedError):
            code = ended.error.code
            excuses = self._process.history.excuses
            if code != "stale-epoch" and (test.robot, code) not in excuses:
                raise Violation(
                    f"{self._process.world.now_s:.3f}: {test.robot} is left out, refused as "
                    f"{ended.error.code}: {ended.error}"
                )
        elif test.failures + 1 < ATTEMPTS and test.attempt < ATTEMPTS_IN_ALL:
            raise Violation(
                f"{self._process.world.now_s:.3f}: {test.robot} is left out after "
                f"{test.failures + 1} failures: {outcome.reason}"
            )


def _is_loss(ended: Ended) -> bool:
    """Return whether the error reports silence rather than an answer of the robot itself."""
    said = str(ended.error)
    return "went silent" in said or "did not return" in said


def _event(robot: str, ask: Ask, answer: Any) -> Event:
    match answer:
        case GoalAccepted():
            return Accepted(answer)
        case GoalResult():
            return Fetched(answer)
        case Refusal():
            return Refused(ask.question, RefusedError(answer.code, answer.reason, robot))
        case NoAnswer():
            return Unanswered(ask.question, NoReplyError(f"{robot} does not answer {ask}"))
        case _:
            return CancelTaken()


def _estimate(result: GoalResult) -> FrequencyResponse:
    robot = result.goal_id.rsplit(".", 2)[1]
    return useless(robot) if result.reason == BAD_SENSOR else response_of(robot)
