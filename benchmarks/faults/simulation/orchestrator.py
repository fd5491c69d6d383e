"""An orchestrator process that leases robots, conducts a study on them, and ends or is killed."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from benchmarks.faults.simulation.history import History, Violation
from benchmarks.faults.simulation.network import Network, NoAnswer, Node, OnAnswer
from benchmarks.faults.simulation.repository import SimulatedLog, SimulatedRepository
from benchmarks.faults.simulation.robot import BAD_SENSOR, SimulatedRobot
from benchmarks.faults.simulation.study import RankingStudy, response_of, useless
from benchmarks.faults.simulation.world import World
from nufleet.orchestrator.conduct import leases as robot_leases
from nufleet.orchestrator.conduct.attempts import ATTEMPTS, ATTEMPTS_IN_ALL, Attempts, Settled
from nufleet.orchestrator.conduct.leases import RENEW_EVERY_S
from nufleet.orchestrator.conduct.replay import OpenRound, OpenTest, resume, round_of
from nufleet.orchestrator.fleet.client import QUERY_TIMEOUT_S, RESULT_TIMEOUT_S
from nufleet.orchestrator.fleet.goal_events import (
    Accepted,
    Ask,
    CancelTaken,
    Ended,
    Event,
    Fetched,
    Heard,
    InterruptAsked,
    Passed,
    Question,
    Refused,
    Sighting,
    TokenBack,
    TokenLost,
    Unanswered,
)
from nufleet.orchestrator.fleet.goal_pursuit import RETURN_PATIENCE_S, Pursuit
from nufleet.orchestrator.repository.errors import LeaseHeldError, LeaseLostError, RepositoryError
from nufleet.orchestrator.repository.records import Lease, Renewal, TrialStatus
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.robot_agent.rules.freezes import FROZEN_S
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.shared.errors import NoReplyError, RefusedError, RobotOwnedError, StudyError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import (
    Description,
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Refusal,
    RobotState,
)

INNOCENT = frozenset({"stopped", "stale-epoch", "fault", "journal"})
"""Codes of refusals after which a robot may be dropped: a person or another orchestrator decided
so, or the robot's own state requires it."""

ON_ITS_WAY_S = 0.1 + FROZEN_S
"""Longest time between the sending of a goal and its motion: the delay of the network, and of a
process frozen for a moment."""

REST_WITHIN_S = 0.5
"""Time after an interrupt within which a reachable robot begins to come to rest."""


@dataclass
class Sight:
    """An orchestrator's knowledge of one robot, as `RobotWatch` keeps it."""

    alive: bool = False
    """Whether the robot's token is present."""

    heard_s: float = -math.inf
    """Time of the latest news of the robot."""

    boot_id: str = ""
    """Id of the agent process that published the latest state."""

    sequence: int = -1
    """Sequence number of the latest state."""


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


class SimulatedOrchestrator:
    """One process that ranks; `over` is how it ended, None while it runs."""

    def __init__(
        self,
        name: str,
        world: World,
        network: Network,
        history: History,
        robots: dict[str, SimulatedRobot],
        repository: SimulatedRepository,
        study_id: str,
        clock: Callable[[], float],
        everyone: Sequence[SimulatedOrchestrator],
    ) -> None:
        self.name = name
        self.world, self.network, self.history = world, network, history
        self.over: str | None = None
        self.ranking: tuple[str, ...] = ()
        self.dropped: dict[str, str] = {}
        self.leases: tuple[Lease, ...] = ()
        self.interrupted = False
        self.commands = False
        self._robots, self._repository, self._study_id = robots, repository, study_id
        self._clock = clock
        self._everyone = everyone
        self._sights = {robot: Sight() for robot in robots}
        self._runs: dict[str, Run] = {}
        self._abandoned: dict[str, tuple[str, ...]] = {}
        self._descriptions: dict[str, Description] = {}
        self._watched: dict[tuple[str, str, int], tuple[Renewal, float]] = {}
        self._tokens: set[str] = set()
        self._failure: Exception | None = None
        self._renewed_s = self._described_s = 0.0
        self._round: OpenRound | None = None
        self._outcomes: dict[str, TestOutcome] = {}
        self._study: RankingStudy
        self._attempts: Attempts
        self._log: SimulatedLog
        self.node: Node = network.join("orchestrator", name, self)
        for robot in robots.values():
            robot.listeners.append(self)
        world.after(0.2, lambda: self.node.do(self._describe_all))

    # Ending.

    def kill(self) -> None:
        """End the process at once, without sending anything."""
        self._end("killed")

    def interrupt(self) -> None:
        """Interrupt the study, as Ctrl-C and a lost lease do."""
        self.node.do(self._interrupt)

    def _interrupt(self) -> None:
        if self.over is not None or self.interrupted:
            return
        self.interrupted, self.commands = True, False
        now_s = self.world.now_s
        self.history.tell(now_s, f"{self.name} is interrupted")
        on_its_way_s = self.network.weather.late_s + ON_ITS_WAY_S
        self.history.interrupted[self.name] = now_s + on_its_way_s
        self._interrupt_all()
        weather = self.network.weather
        if not (weather.lost or weather.late):
            for motion in self.history.motions:
                if motion.owner == self.name and motion.resting_s is None:
                    self._must_rest(motion)
        self._end_if_idle()

    def _interrupt_all(self) -> None:
        for run in tuple(self._runs.values()):
            self._take(run, InterruptAsked())

    def _must_rest(self, motion: Any) -> None:
        """Check that a robot that stays reachable begins to come to rest soon."""
        robot = self._robots[motion.robot]

        def reached() -> bool:
            return (
                robot.agent is not None
                and self.network.reaches(robot.agent.node)
                and not robot.agent.node.frozen
                and self.network.reaches(self.node)
                and not self.node.frozen
            )

        agent, asked_s = robot.agent, self.world.now_s
        if not reached():
            return

        def look() -> None:
            late = motion.resting_s is None and motion.ended_s is None
            if late and reached() and robot.agent is agent and not agent.node.quiet_since:  # type: ignore[union-attr]
                raise Violation(
                    f"{self.world.now_s:.3f}: {motion.robot} moves on {REST_WITHIN_S} s after the "
                    f"interrupt at {asked_s:.3f}"
                )

        self.world.after(REST_WITHIN_S, look)

    def _end(self, how: str) -> None:
        if self.over is not None:
            return
        self.over = how
        self.history.tell(self.world.now_s, f"{self.name} ends: {how}")
        if how != "killed":
            self._repository.release(self.leases)
        self.leases = ()
        self.commands = False
        self.network.end(self.node)
        for robot in self._robots.values():
            robot.listeners.remove(self)

    def _end_if_idle(self) -> None:
        if not self._runs and (self.interrupted or self._failure is not None):
            how = "interrupted" if self._failure is None else str(self._failure)
            now_s = self.world.now_s
            for robot in self._robots:
                unsure = robot in self._abandoned
                # A robot that confirmed nothing may have received the interrupt too late; it comes
                # to rest when it loses its owner.
                self.history.interrupt_returned(robot, self.name, now_s + (4.0 if unsure else 0.0))
            # The process may outlive the study, as a notebook does, so its token stays for a while.
            lingers_s = 0.0 if self._abandoned else self.world.between(0.0, 15.0)
            self.world.after(lingers_s, lambda: self._end(how))

    def _fail(self, error: Exception) -> None:
        """End because of an error, after all robots have been brought to rest."""
        self._failure = self._failure or error
        self._interrupt()

    # Events from the network.

    def told(self, kind: str, name: str, alive: bool) -> None:
        if kind == "orchestrator":
            (self._tokens.add if alive else self._tokens.discard)(name)
            return
        sight = self._sights[name]
        sight.alive, sight.heard_s = alive, self.world.now_s
        run = self._runs.get(name)
        if run is not None:
            self._take(run, TokenBack() if alive else TokenLost())

    def asked(self, question: str, body: Any, answer: OnAnswer) -> None:
        raise AssertionError("an orchestrator receives no requests")

    def heard(self, robot: str, state: RobotState) -> None:
        """Receive a robot's state; ignore one older than the last of the same agent process."""
        sight = self._sights[robot]
        if sight.boot_id == state.boot_id and state.sequence <= sight.sequence:
            return
        sight.boot_id, sight.sequence = state.boot_id, state.sequence
        sight.heard_s = self.world.now_s
        run = self._runs.get(robot)
        if run is not None:
            self._take(run, Heard(state))

    def is_alive(self, orchestrator: str) -> bool:
        """Return whether another orchestrator's token is present according to the network."""
        return orchestrator in self._tokens

    @property
    def orchestrator_id(self) -> str:
        """Name of this orchestrator, under the name that the attribute has in `Fleet`."""
        return self.name

    # Taking robots.

    def _ask(
        self, robot: str, question: str, body: Any, timeout_s: float, then: Callable[[Any], None]
    ) -> None:
        self.network.ask(
            self.node, "robot", robot, question, body, timeout_s=timeout_s, on_answer=then
        )

    def _describe_all(self) -> None:
        self._descriptions = {}
        self._described_s = self.world.now_s

        def told(robot: str, answer: Any) -> None:
            if self.over is not None:
                return
            if not isinstance(answer, Description):
                self._end(f"{robot} does not describe itself")
                return
            self._descriptions[robot] = answer
            if len(self._descriptions) < len(self._robots):
                return
            if self.leases:
                self._confirm()
            else:
                self._lease()

        for robot in self._robots:
            self._ask(robot, "describe", None, QUERY_TIMEOUT_S, lambda a, r=robot: told(r, a))

    def _lease(self) -> None:
        if self.over is not None or self.interrupted:
            return
        now_s, clock_s = self.world.now_s, self._clock()
        silent = [r for r, since_s in self._watched.values() if now_s - since_s > r.term_s]
        fleet: Any = self
        try:
            robot_leases.check_others(fleet, self._descriptions, self._repository.last(clock_s))
            self.leases = self._repository.acquire(
                self._robots,
                owner=self.name,
                above_epochs={r: found.epoch for r, found in self._descriptions.items()},
                now_s=clock_s,
                silent=silent,
            )
        except LeaseHeldError as held:
            for renewal in held.renewals:
                key = (renewal.robot, renewal.owner, renewal.epoch)
                if self._watched.setdefault(key, (renewal, now_s))[0] != renewal:
                    self._end(str(held))
                    return
            self.world.after(0.5, lambda: self.node.do(self._lease))
            return
        except (RobotOwnedError, RepositoryError) as error:
            self._end(str(error))
            return
        if self._watched:
            self._describe_all()  # another orchestrator may have come while this one waited
        else:
            self._take_over()

    def _confirm(self) -> None:
        fleet: Any = self
        try:
            robot_leases.check_others(
                fleet, self._descriptions, self._repository.last(self._clock())
            )
        except RobotOwnedError as error:
            self._end(str(error))
            return
        self._take_over()

    def _take_over(self) -> None:
        now_s = self.world.now_s
        self.history.tell(now_s, f"{self.name} takes all robots, {self.leases[0].epoch}")
        # For owners from another repository, the robots' own knowledge is the only evidence.
        known = {m.owner for m in self.history.motions if m.began_s < self._described_s}
        for other in self._everyone:
            commands, other.commands = other.commands, False
            if other is self or other.name not in known:
                continue
            if commands and other.name in self._tokens:
                raise Violation(f"{now_s:.3f}: {self.name} takes the robots of {other.name}")
        self.commands = True
        self._renewed_s = now_s
        self.world.after(RENEW_EVERY_S, lambda: self.node.do(self._renew))
        self._begin_study()

    def _renew(self) -> None:
        if self.over is not None:
            return
        try:
            self._repository.renew(self.leases, self._clock())
        except LeaseLostError as error:
            self._fail(error)
            self._check_lost(error)
            return
        except RepositoryError as error:
            if self.world.now_s - self._renewed_s > self.leases[0].term_s:
                self._fail(error)
                return
        else:
            self._renewed_s = self.world.now_s
        self.world.after(RENEW_EVERY_S, lambda: self.node.do(self._renew))

    def _check_lost(self, error: LeaseLostError) -> None:
        known = self._repository.leases[error.robot]
        if known.owner == self.name:
            raise Violation(
                f"{self.world.now_s:.3f}: {self.name} loses its leases, but none was taken over: "
                f"{error}"
            )

    # The study.

    def _begin_study(self) -> None:
        epochs = {lease.robot: lease.epoch for lease in self.leases}
        self._log = SimulatedLog(self._repository, self._study_id, epochs)
        self._study = RankingStudy(tuple(self._robots))
        trials = tuple(self._repository.trials.values())
        try:
            at = resume(self._study_id, self._study, trials)
        except StudyError as error:
            self._end(f"failed: {error}")
            return
        self._go_on(at.open)

    def _go_on(self, at: OpenRound | None) -> None:
        if at is None:
            self.ranking = self._study.ranking
            self.dropped = dict(self._study.dropped)
            self._end("complete")
            return
        self._round, self._outcomes = at, {}
        try:
            self._log.intend(at.tests)
        except RepositoryError as error:
            self._fail(error)
            return
        specs = {name: robot.spec for name, robot in self._robots.items()}
        self._attempts = Attempts(self._log, specs, estimate=_estimate)
        for test in at.tests:
            self._pursue(test)
        self._end_if_idle()

    def _pursue(self, test: OpenTest) -> None:
        if self.interrupted:
            return
        sight = self._sights[test.robot]
        epochs = {lease.robot: lease.epoch for lease in self.leases}
        request = GoalRequest(
            goal_id=test.goal_id,
            owner=self.name,
            epoch=epochs[test.robot],
            motion=test.excitation,
        )
        pursuit = Pursuit(
            test.robot,
            test.goal_id,
            Sighting(sight.alive, sight.heard_s),
            self.world.now_s,
            taken_before=test.accepted_by is not None,
            abandoned=self._abandoned.get(test.robot, ()),
        )
        run = self._runs[test.robot] = Run(test, pursuit, request)
        self._take(run, Passed())

    def _take(self, run: Run, event: Event) -> None:
        if self._runs.get(run.test.robot) is not run:
            return
        now_s = self.world.now_s
        asks = run.pursuit.take(event, now_s)
        accepted = run.pursuit.accepted
        if accepted is not None and not run.stored:
            run.stored = True
            try:
                self._log.accepted(run.test, accepted)
            except RepositoryError as error:
                self._send(run, asks)
                self._fail(error)
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

        self.world.at(time_s, lambda: self.node.do(wake))

    def _send(self, run: Run, asks: tuple[Ask, ...]) -> None:
        for ask in asks:
            epoch = run.request.epoch
            bodies = {
                Question.GOAL: run.request,
                Question.RESULT: ask.goal_id,
                Question.CANCEL: (ask.goal_id, Commander(self.name, epoch)),
            }
            timeout_s = RESULT_TIMEOUT_S if ask.question is Question.RESULT else QUERY_TIMEOUT_S
            self._ask(
                run.test.robot,
                ask.question,
                bodies[ask.question],
                timeout_s,
                lambda answer, ask=ask: self._answered(run, ask, answer),
            )

    def _answered(self, run: Run, ask: Ask, answer: Any) -> None:
        if self.over is not None:
            return
        robot = run.test.robot
        if not isinstance(answer, NoAnswer):
            self._sights[robot].heard_s = self.world.now_s
        self._take(run, _event(robot, ask, answer))

    def _ended(self, run: Run, ended: Ended) -> None:
        robot, now_s = run.test.robot, self.world.now_s
        if ended.result is None:
            self.history.tell(now_s, f"{run.test.goal_id} ends without a result: {ended}")
            self._check_given_up(run, ended)
        del self._runs[robot]
        self._abandoned.pop(robot, None)
        if ended.abandoned:
            self._abandoned[robot] = ended.abandoned
        try:
            settled = self._attempts.settle(run.test, ended, interrupted=self.interrupted)
            if settled.following is not None and not self.interrupted:
                self._log.intend([settled.following])
        except RepositoryError as error:
            self._fail(error)
            self._end_if_idle()
            return
        if self.interrupted:
            self._end_if_idle()
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
            self._end(f"failed: {error}")
            return
        question = self._study.ask()
        self._go_on(None if question is None else round_of(self._study_id, question))

    # Checks of the promises.

    def _check_given_up(self, run: Run, ended: Ended) -> None:
        if isinstance(ended.error, RefusedError) or ended.error is None:
            return
        silent_s = self.world.now_s - self._sights[run.test.robot].heard_s
        patient = isinstance(ended.error, NoReplyError)  # unanswered for ANSWER_PATIENCE_S
        if silent_s < RETURN_PATIENCE_S - 1e-6 and not patient and _is_loss(ended):
            raise Violation(
                f"{self.world.now_s:.3f}: {run.test.robot} is given up for {run.test.goal_id}, and "
                f"was heard {silent_s:.3f} s ago: {ended.error}"
            )

    def _check_failed(self, run: Run, outcome: Failed, ended: Ended) -> None:
        test = run.test
        if isinstance(ended.error, RefusedError):
            if ended.error.code not in INNOCENT:
                raise Violation(
                    f"{self.world.now_s:.3f}: {test.robot} is left out, refused as "
                    f"{ended.error.code}: {ended.error}"
                )
        elif test.failures + 1 < ATTEMPTS and test.attempt < ATTEMPTS_IN_ALL:
            raise Violation(
                f"{self.world.now_s:.3f}: {test.robot} is left out after {test.failures + 1} "
                f"failures: {outcome.reason}"
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
