"""Runs one round of tests on many robots at once, with retries, and returns their outcomes."""

from __future__ import annotations

import os
import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

from nufleet.orchestrator.conduct.attempts import Attempts, Settled, estimated
from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.fleet.goal_loop import GoalLoop
from nufleet.orchestrator.fleet.goal_runner import GoalRunner, Interrupted
from nufleet.orchestrator.study.outcomes import TestOutcome
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import GoalAccepted, GoalResult

OnAttempt = Callable[[str, int, str], None]

STORING_AT_ONCE = 16
"""Number of robots whose answers are judged and stored at once, so that they share one commit."""


class Dispatcher:
    """Sends tests to robots and stores what they return.

    Each test is stored before it is sent, and its result before anything else is sent to the same
    robot. `interrupt`, called from another thread, ends a round with all robots at rest.
    """

    def __init__(
        self,
        fleet: Fleet,
        log: TrialLog,
        specs: Mapping[str, RobotSpec],
        *,
        on_attempt_failed: OnAttempt,
    ) -> None:
        """Prepare; nothing is sent yet.

        Args:
            fleet: Client of the fleet whose robots are tested; it holds their leases.
            log: Storage for everything that is sent and measured.
            specs: Spec of each robot, by name; no test longer than the robot accepts is sent.
            on_attempt_failed: Callback that receives robot, attempt number and reason of every
                failed attempt, on other threads.
        """
        self._goals = GoalRunner(fleet)
        self._log = log
        self._specs = specs
        self._on_attempt_failed = on_attempt_failed
        self._estimating = threading.Lock()

    def run(self, tests: Sequence[OpenTest]) -> dict[str, TestOutcome]:
        """Run one test on each of several robots, all at the same time.

        Args:
            tests: Tests to run, at most one per robot. A test that an earlier orchestrator sent
                already keeps its goal id, so that the robot moves only once.

        Returns:
            The outcome of each test, by robot.

        Raises:
            Interrupted: `interrupt` was called; every robot that answers is at rest.
            RepositoryError: Something could not be stored; every robot that answers is at rest.
        """
        self._log.intend(tests)
        attempts = Attempts(self._log, self._specs, estimate=self._estimated)
        storing_at_once = min(STORING_AT_ONCE, len(tests) + (os.cpu_count() or 1))
        with (
            self._goals.pursuing() as loop,
            ThreadPoolExecutor(storing_at_once, thread_name_prefix="store") as stores,
        ):
            tested = _Round(self._goals, loop, stores, self._log, attempts, self._on_attempt_failed)
            loop.post(lambda: tested.open(tests))
            self._goals.wait_for(loop, tested.over)
        if tested.failure is not None:
            raise tested.failure
        if self._goals.interrupted:
            raise Interrupted
        return {test.robot: tested.outcomes[test.robot] for test in tests}

    def interrupt(self) -> None:
        """End the round by cancelling all goals at once, so that the robots come to rest."""
        self._goals.interrupt()

    def acknowledge_all(self) -> None:
        """Acknowledge the last results of every robot, so that it may discard them."""
        self._goals.acknowledge_all()

    def _estimated(self, result: GoalResult) -> FrequencyResponse:
        # Threads that estimate at the same time take the interpreter from each other in every call
        # of NumPy, which costs more than it gains.
        with self._log.ending(), self._estimating:
            return estimated(result)


class _Round:
    """One round of tests; its methods run on the loop's thread, slow storage on other threads."""

    def __init__(
        self,
        goals: GoalRunner,
        loop: GoalLoop,
        stores: ThreadPoolExecutor,
        log: TrialLog,
        attempts: Attempts,
        on_attempt_failed: OnAttempt,
    ) -> None:
        self._goals, self._loop, self._stores = goals, loop, stores
        self._log, self._attempts = log, attempts
        self._on_attempt_failed = on_attempt_failed
        self._open = 0
        self._storing: dict[str, deque[_Job]] = {}
        self.outcomes: dict[str, TestOutcome] = {}
        self.failure: BaseException | None = None
        self.over = threading.Event()

    def open(self, tests: Sequence[OpenTest]) -> None:
        """Start pursuing the first attempt at every test."""
        self._open = len(tests)
        for test in tests:
            self._pursue(test)

    def _pursue(self, test: OpenTest) -> None:
        self._loop.begin(
            self._goals.errand(
                test.robot,
                test.goal_id,
                test.excitation,
                on_accepted=lambda accepted: self._accepted(test, accepted),
                on_ended=lambda ended: self._ended(test, ended),
                taken_before=test.accepted_by is not None,
            )
        )

    def _accepted(self, test: OpenTest, accepted: GoalAccepted) -> None:
        self._store(_Job(test.robot, lambda: self._log.accepted(test, accepted)))

    def _ended(self, test: OpenTest, ended: Ended) -> None:
        interrupted = self._goals.interrupted

        def settle() -> Callable[[], None]:
            settled = self._attempts.settle(test, ended, interrupted=interrupted)
            return lambda: self._settled(test, settled)

        self._store(_Job(test.robot, settle, decides=True))

    def _settled(self, test: OpenTest, settled: Settled) -> None:
        following = settled.following
        if self._goals.interrupted:
            self._close_one()
            return
        if settled.failure is not None:
            self._on_attempt_failed(test.robot, test.attempt, settled.failure)
        if settled.outcome is not None:
            self.outcomes[test.robot] = settled.outcome
        if following is None:
            self._close_one()
            return

        def intend() -> Callable[[], None]:
            self._log.intend([following])
            return lambda: self._pursue(following)

        self._store(_Job(test.robot, intend, decides=True))

    def _store(self, job: _Job) -> None:
        """Run a job on a thread that may wait for the disk, after all earlier jobs of its robot."""
        waiting = self._storing.setdefault(job.robot, deque())
        waiting.append(job)
        if len(waiting) == 1:
            self._begin(job)

    def _begin(self, job: _Job) -> None:
        done = self._stores.submit(job.work)
        done.add_done_callback(lambda _: self._loop.post(lambda: self._stored(job, done)))

    def _stored(self, job: _Job, done: Future[Callable[[], None] | None]) -> None:
        waiting = self._storing[job.robot]
        waiting.popleft()
        if waiting:
            self._begin(waiting[0])
        error = done.exception()
        if error is not None:
            # A motion that cannot be stored must not happen, or a resumed study would not know it.
            self.failure = self.failure or error
            self._goals.interrupt()
            if job.decides:
                self._close_one()
            return
        then = done.result()
        if then is not None:
            then()

    def _close_one(self) -> None:
        self._open -= 1
        if self._open == 0:
            self.over.set()


@dataclass(frozen=True)
class _Job:
    """A write to the repository, and the step that follows it."""

    robot: str
    """Name of the robot; jobs of one robot run in order."""
    work: Callable[[], Callable[[], None] | None]
    """Writes, and returns a follow-up for the loop's thread, or None."""
    decides: bool = False
    """Whether the robot's next step depends on this job.

    If such a job fails, the robot's part in the round is over.
    """
