"""Has one robot do one motion: sent once, waited for, fetched, acknowledged with the next one."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable

from orchestrator.fleet import Fleet
from orchestrator.overdue import Overdue
from orchestrator.robot_watch import HEARTBEAT_LOST_S, RobotWatch
from shared.errors import NoReplyError, NufleetError, RefusedError, RobotLostError
from shared.messages import GoalAccepted, GoalRequest, GoalResult, RobotState
from shared.motions import Motion

RETURN_PATIENCE_S = 10.0
"""How long a lost robot may take to come back before its attempt counts as failed."""

_ASK_AGAIN_S = 0.05

_PASSING = frozenset({"owner-not-alive", "overloaded", "shutting-down"})
"""Refusals that say nothing about the goal: after a restart of the router a robot may hear of it
before its owner; one whose agent is being restarted takes it a little later."""

_log = logging.getLogger(__name__)


class Interrupted(Exception):  # noqa: N818 - not an error: somebody asked for the end
    """The motions were asked to end before they were complete."""


class GoalRunner:
    """Runs motions on the robots of a fleet; may be called from many threads.

    `interrupt` ends all of them from another thread, with robots at rest.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._interrupted = threading.Event()
        self._lock = threading.Lock()
        self._running: dict[str, str] = {}
        self._unacknowledged: dict[str, tuple[str, ...]] = {}

    @property
    def interrupted(self) -> bool:
        """Whether the end was asked for."""
        return self._interrupted.is_set()

    def run(
        self,
        robot: str,
        goal_id: str,
        motion: Motion,
        *,
        on_accepted: Callable[[GoalAccepted], None] = lambda accepted: None,
    ) -> GoalResult:
        """Have a robot do a motion and return what it measured, however that ended.

        Args:
            robot: who.
            goal_id: unique; the same id and motion again is the same goal.
            motion: what.
            on_accepted: is told when the robot has taken it; what it raises ends the motion.

        Raises:
            RefusedError: the robot refuses, and says why.
            RobotLostError: it is gone and does not return, knows nothing of the goal when it
                does, or is overdue.
            NoReplyError: it does not answer.
            MalformedMessageError: its answer is none.
            Interrupted: `interrupt` was called before the motion began.
        """
        request = GoalRequest(
            goal_id=goal_id,
            owner=self._fleet.orchestrator_id,
            epoch=self._fleet.epoch(robot),
            motion=motion,
            acknowledges=self._unacknowledged.get(robot, ()),
        )
        watch = self._wait_until_there(robot, goal_id)
        if self._interrupted.is_set():
            raise Interrupted
        with self._lock:
            self._running[robot] = goal_id
        try:
            accepted = self._submit(robot, request)
            self._unacknowledged.pop(robot, None)
            try:
                on_accepted(accepted)
            except BaseException:
                self._cancel(robot, goal_id)
                raise
            lost = self._wait_for_end(watch, accepted)
            if lost is not None:
                _log.info("%s: waiting for its return", lost)
            result = self._fetch(watch, goal_id, lost)
        except BaseException as error:
            if not isinstance(error, Exception):
                # Ctrl-C in this very thread, while the goal still counts as running.
                self.interrupt()
            raise
        finally:
            with self._lock:
                self._running.pop(robot, None)
        self._unacknowledged[robot] = (goal_id,)
        return result

    def boot_id(self, robot: str) -> str:
        """Return which agent process serves a robot; raises RobotLostError, NoReplyError."""
        self._wait_until_there(robot)
        return self._fleet.describe(robot).boot_id

    def result(self, robot: str, goal_id: str) -> GoalResult:
        """Return how a goal of earlier ended; raises RefusedError when its robot does not know."""
        result = self._fetch(self._wait_until_there(robot, goal_id), goal_id, None)
        self._unacknowledged[robot] = (goal_id,)
        return result

    def interrupt(self) -> None:
        """Cancel every running goal, so that the robots come to rest."""
        self._interrupted.set()
        with self._lock:
            running = dict(self._running)
        for robot, goal_id in running.items():
            self._cancel(robot, goal_id)

    def acknowledge_all(self) -> None:
        """Tell every robot that its last results arrived."""
        for robot, goal_ids in self._unacknowledged.items():
            try:
                self._fleet.acknowledge(robot, goal_ids)
            except NufleetError as error:
                _log.warning("%s keeps its last results until they expire: %s", robot, error)
        self._unacknowledged.clear()

    def _cancel(self, robot: str, goal_id: str) -> None:
        try:
            self._fleet.cancel(robot, goal_id)
        except RefusedError as error:
            _log.info("cancelling on %s: %s", robot, error)
        except NufleetError as error:
            # Its agent rests by itself when this orchestrator's token disappears.
            _log.warning("cancelling on %s: %s", robot, error)

    def _wait_until_there(self, robot: str, goal_id: str | None = None) -> RobotWatch:
        watch = self._fleet.watch(robot)
        if not watch.wait_until(lambda w: w.alive, timeout_s=RETURN_PATIENCE_S):
            during = "" if goal_id is None else f" for goal {goal_id}"
            raise RobotLostError(
                f"robot {robot} is gone and did not return{during} within {RETURN_PATIENCE_S:g} s; "
                "is its agent running?"
            )
        return watch

    def _submit(self, robot: str, request: GoalRequest) -> GoalAccepted:
        """Send a goal until there is an answer; asking again cannot move the robot again."""
        give_up_s = time.monotonic() + RETURN_PATIENCE_S
        while True:
            try:
                return self._fleet.submit(robot, request)
            except NoReplyError as error:
                if time.monotonic() > give_up_s:
                    raise
                _log.info("%s: asking again", error)
            except RefusedError as error:
                if error.code not in _PASSING or time.monotonic() > give_up_s:
                    raise
                _log.info("%s: asking again", error)
            time.sleep(_ASK_AGAIN_S)
            self._wait_until_there(robot, request.goal_id)

    def _wait_for_end(self, watch: RobotWatch, accepted: GoalAccepted) -> str | None:
        """Return when the goal has ended, or how its robot was lost; raise when it is overdue."""
        goal_id = accepted.goal_id
        overdue = Overdue(accepted.wall_duration_s, time.monotonic())

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
                return None
            if watch.silent_s > HEARTBEAT_LOST_S:
                return (
                    f"robot {watch.robot} went silent during {goal_id}: "
                    f"no heartbeat for {watch.silent_s:.1f} s"
                )
            if overdue.is_late(_progress(state, goal_id), time.monotonic()):
                self._fleet.cancel(watch.robot, goal_id)
                raise RobotLostError(
                    f"robot {watch.robot} is overdue with {goal_id}: for {overdue.grace_s:.0f} s "
                    f"it got no further than {overdue.progress:.0%}; see whether its agent hangs"
                )
        if not watch.alive:
            return f"robot {watch.robot} disappeared during {goal_id}"
        state = watch.state
        if state is not None and state.boot_id != accepted.boot_id:
            return f"the agent of {watch.robot} restarted during {goal_id}"
        return None

    def _fetch(self, watch: RobotWatch, goal_id: str, lost: str | None) -> GoalResult:
        """Return what a robot says of a goal, however often it is lost meanwhile.

        A result is kept until it is acknowledged, so asking again by its id loses none.
        """
        robot = watch.robot
        give_up_s = time.monotonic() + RETURN_PATIENCE_S
        asked = 0
        while True:
            asked += 1
            left_s = max(0.0, give_up_s - time.monotonic())
            # One that was silent and has its token still has to be heard first.
            if not watch.wait_until(_is_heard, timeout_s=left_s):
                raise RobotLostError(f"{lost or f'robot {robot} is gone'}, and it did not return")
            try:
                return self._fleet.result(robot, goal_id)
            except NoReplyError as error:
                # A question that is lost takes longer than the patience; one is not enough.
                if asked > 1 and time.monotonic() > give_up_s:
                    raise
                _log.info("%s: asking again", error)
            except RefusedError as error:
                if lost is None:
                    raise
                if error.code != "not-finished":
                    raise RobotLostError(f"{lost}: {error.reason}") from error
                if time.monotonic() > give_up_s:
                    raise RobotLostError(f"{lost}, and it is not at rest") from error
            time.sleep(_ASK_AGAIN_S)


def _is_heard(watch: RobotWatch) -> bool:
    return watch.alive and watch.silent_s < HEARTBEAT_LOST_S


def _progress(state: RobotState | None, goal_id: str) -> float:
    return state.progress if state is not None and state.goal_id == goal_id else 0.0
