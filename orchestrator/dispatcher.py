"""Runs one round of tests on many robots at once, with retries, and says what came of each."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

from orchestrator.fleet import Fleet
from orchestrator.robot_watch import HEARTBEAT_LOST_S, RobotWatch
from shared.errors import (
    MalformedMessageError,
    NoReplyError,
    NufleetError,
    RefusedError,
    RobotLostError,
)
from shared.excitation import Excitation
from shared.frequency_response import FrequencyResponse, estimate_frequency_response
from shared.messages import GoalAccepted, GoalRequest, GoalResult, Outcome

ATTEMPTS = 3
RETURN_PATIENCE_S = 10.0
"""How long a lost robot may take to come back before its attempt counts as failed."""
_OVERDUE_FACTOR = 1.5
_OVERDUE_GRACE_S = 30.0

_log = logging.getLogger(__name__)


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


class Interrupted(Exception):  # noqa: N818 - not an error: somebody asked for the end
    """The round was asked to end before it was complete."""


class Dispatcher:
    """Sends tests to robots; `interrupt` ends a round from another thread with robots at rest."""

    def __init__(self, fleet: Fleet, *, on_attempt_failed: OnAttempt) -> None:
        self._fleet = fleet
        self._on_attempt_failed = on_attempt_failed
        self._interrupted = threading.Event()
        self._lock = threading.Lock()
        self._running: dict[str, str] = {}
        self._unacknowledged: dict[str, tuple[str, ...]] = {}

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
        self._interrupted.set()
        with self._lock:
            running = dict(self._running)
        for robot, goal_id in running.items():
            try:
                self._fleet.cancel(robot, goal_id)
            except RefusedError as error:
                _log.info("cancelling on %s: %s", robot, error)
            except NufleetError as error:
                # Its agent rests by itself when this orchestrator's token disappears.
                _log.warning("cancelling on %s: %s", robot, error)

    def acknowledge_all(self) -> None:
        """Tell every robot that its last results arrived."""
        for robot, goal_ids in self._unacknowledged.items():
            try:
                self._fleet.acknowledge(robot, goal_ids)
            except NufleetError as error:
                _log.warning("%s keeps its last results until they expire: %s", robot, error)
        self._unacknowledged.clear()

    def _test(self, round_id: str, robot: str, excitation: Excitation) -> TestOutcome:
        reason = ""
        robot_time_s = 0.0
        for attempt in range(1, ATTEMPTS + 1):
            goal_id = f"{round_id}.{robot}.{attempt}"
            try:
                result = self._attempt(robot, goal_id, excitation)
            except RefusedError as error:
                return Failed(robot, str(error), attempt, robot_time_s)
            except (NoReplyError, RobotLostError, MalformedMessageError) as error:
                reason = str(error)
                self._on_attempt_failed(robot, attempt, reason)
                continue
            robot_time_s += len(result.reference) * result.plan.sample_time_s
            if self._interrupted.is_set():
                raise Interrupted
            if result.outcome is not Outcome.COMPLETED:
                reason = f"{result.outcome}: {result.reason}"
            else:
                response = estimate_frequency_response(
                    result.reference, result.response, result.plan
                )
                if response.quality.usable:
                    return Measured(robot, response, result, attempt, robot_time_s)
                reason = "; ".join(str(finding) for finding in response.quality.reasons)
                excitation = _longer(excitation, result)
            self._on_attempt_failed(robot, attempt, reason)
        return Failed(robot, reason, ATTEMPTS, robot_time_s)

    def _attempt(self, robot: str, goal_id: str, excitation: Excitation) -> GoalResult:
        request = GoalRequest(
            goal_id=goal_id,
            owner=self._fleet.orchestrator_id,
            excitation=excitation,
            acknowledges=self._unacknowledged.get(robot, ()),
        )
        watch = self._fleet.watch(robot)
        if not watch.wait_until(lambda w: w.alive, timeout_s=RETURN_PATIENCE_S):
            raise RobotLostError(f"robot {robot} is gone and did not return")
        if self._interrupted.is_set():
            raise Interrupted
        with self._lock:
            self._running[robot] = goal_id
        try:
            accepted = self._submit(robot, request)
            self._unacknowledged.pop(robot, None)
            self._wait_for_end(watch, accepted)
            result = self._fleet.result(robot, goal_id)
        finally:
            with self._lock:
                self._running.pop(robot, None)
        self._unacknowledged[robot] = (goal_id,)
        return result

    def _submit(self, robot: str, request: GoalRequest) -> GoalAccepted:
        try:
            return self._fleet.submit(robot, request)
        except NoReplyError as error:
            # The same id again is the same goal: asking twice cannot move the robot twice.
            _log.info("%s: asking again", error)
            return self._fleet.submit(robot, request)

    def _wait_for_end(self, watch: RobotWatch, accepted: GoalAccepted) -> None:
        """Return when the goal has ended; raise when its robot is lost, restarted or overdue."""
        goal_id = accepted.goal_id
        patience_s = accepted.wall_duration_s * _OVERDUE_FACTOR + _OVERDUE_GRACE_S
        deadline = time.monotonic() + patience_s

        def settled(w: RobotWatch) -> bool:
            state = w.state
            if not w.alive:
                return True
            if state is None:
                return False
            return state.boot_id != accepted.boot_id or state.last_goal_id == goal_id

        while not watch.wait_until(settled, timeout_s=HEARTBEAT_LOST_S / 2):
            state = watch.state
            if state is not None and state.goal_id != goal_id and watch.silent_s < HEARTBEAT_LOST_S:
                # Two heartbeats later it still does something else: it has ended, unheard.
                return
            if watch.silent_s > HEARTBEAT_LOST_S:
                raise RobotLostError(
                    f"robot {watch.robot} went silent during {goal_id}: "
                    f"no heartbeat for {watch.silent_s:.1f} s"
                )
            if time.monotonic() > deadline:
                self._fleet.cancel(watch.robot, goal_id)
                raise RobotLostError(
                    f"robot {watch.robot} did not finish {goal_id} within {patience_s:.0f} s"
                )
        if not watch.alive:
            raise RobotLostError(f"robot {watch.robot} disappeared during {goal_id}")
        state = watch.state
        if state is not None and state.boot_id != accepted.boot_id:
            raise RobotLostError(f"the agent of {watch.robot} restarted during {goal_id}")


def _longer(excitation: Excitation, result: GoalResult) -> Excitation:
    """The same test with twice the settling and measuring time, after an unusable response."""
    plan = result.plan
    return excitation.model_copy(
        update={
            "settle_s": 2 * max(plan.settle_samples, plan.ramp_samples) * plan.sample_time_s,
            "segment_min_s": 2 * plan.segment_samples * plan.sample_time_s,
        }
    )
