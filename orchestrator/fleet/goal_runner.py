"""Has robots do motions: each sent once, waited for, fetched, acknowledged with the next one."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.fleet.goal_loop import Errand, GoalLoop
from nufleet.shared.errors import NufleetError
from nufleet.shared.wire.messages import GoalAccepted, GoalRequest, GoalResult
from nufleet.shared.wire.motions import Motion

_log = logging.getLogger(__name__)


class Interrupted(Exception):  # noqa: N818 - not an error: somebody asked for the end
    """The motions were asked to end before they were complete."""


class GoalRunner:
    """Runs motions on the robots of a fleet; may be used from many threads.

    `interrupt` ends all of them from another thread, with robots at rest.
    """

    def __init__(self, fleet: Fleet) -> None:
        self._fleet = fleet
        self._lock = threading.Lock()
        self._interrupted = False
        self._loops: list[GoalLoop] = []
        self._unacknowledged: dict[str, tuple[str, ...]] = {}
        self._abandoned: dict[str, tuple[str, ...]] = {}

    @property
    def interrupted(self) -> bool:
        """Whether the end was asked for."""
        return self._interrupted

    @contextmanager
    def pursuing(self) -> Iterator[GoalLoop]:
        """Open a loop for errands, which `interrupt` ends as well."""
        with GoalLoop(self._fleet) as loop:
            with self._lock:
                self._loops.append(loop)
                if self._interrupted:
                    loop.interrupt()
            try:
                yield loop
            finally:
                with self._lock:
                    self._loops.remove(loop)

    def errand(
        self,
        robot: str,
        goal_id: str,
        motion: Motion,
        *,
        on_ended: Callable[[Ended], None],
        on_accepted: Callable[[GoalAccepted], None] = lambda accepted: None,
        taken_before: bool = False,
    ) -> Errand:
        """Return what is to be pursued, with what this runner knows of the robot's earlier goals.

        Args:
            robot: who.
            goal_id: unique; the same id and motion again is the same goal.
            motion: what.
            on_ended: is told how it ended.
            on_accepted: is told when the robot has taken it.
            taken_before: an earlier orchestrator knows that the robot has taken it.
        """
        acknowledges = self._unacknowledged.get(robot, ())

        def accepted(answer: GoalAccepted) -> None:
            if self._unacknowledged.get(robot) == acknowledges:
                self._unacknowledged.pop(robot, None)
            on_accepted(answer)

        def ended(how: Ended) -> None:
            if how.abandoned:
                self._abandoned[robot] = how.abandoned
                _log.warning(
                    "%s has not confirmed that it is at rest; it stops by itself when it loses "
                    "this orchestrator: %s",
                    robot,
                    how.error,
                )
            else:
                self._abandoned.pop(robot, None)
            if how.result is not None:
                self._unacknowledged[robot] = (goal_id,)
            on_ended(how)

        request = GoalRequest(
            goal_id=goal_id,
            owner=self._fleet.orchestrator_id,
            epoch=self._fleet.epoch(robot),
            motion=motion,
            acknowledges=acknowledges,
        )
        abandoned = tuple(known for known in self._abandoned.get(robot, ()) if known != goal_id)
        return Errand(robot, request, accepted, ended, taken_before, abandoned)

    def run(self, robot: str, goal_id: str, motion: Motion) -> GoalResult:
        """Have a robot do a motion and return what it measured, however that ended.

        Args:
            robot: who.
            goal_id: unique; the same id and motion again is the same goal.
            motion: what.

        Raises:
            RefusedError: the robot refuses, and says why.
            RobotLostError: it is gone and does not return, knows nothing of the goal when it
                does, or is overdue.
            NoReplyError: it is heard, and does not answer.
            MalformedMessageError: its answers are none.
            Interrupted: `interrupt` was called, and there is no result.
        """
        how: list[Ended] = []
        done = threading.Event()

        def on_ended(ended: Ended) -> None:
            how.append(ended)
            done.set()

        with self.pursuing() as loop:
            loop.begin(self.errand(robot, goal_id, motion, on_ended=on_ended))
            self.wait_for(loop, done)
        (ended,) = how
        if ended.result is not None:
            return ended.result
        if ended.interrupted or ended.error is None:
            raise Interrupted
        raise ended.error

    def wait_for(self, loop: GoalLoop, done: threading.Event) -> None:
        """Wait until errands set an event; Ctrl-C meanwhile interrupts all, and is raised then.

        A second Ctrl-C is raised at once: robots stop by themselves when this process has ended.
        """
        try:
            loop.wait_for(done)
        except KeyboardInterrupt:
            self.interrupt()
            loop.wait_for(done)
            raise

    def interrupt(self) -> None:
        """Bring every robot to rest, all at once; nothing is sent afterwards that moves one."""
        with self._lock:
            self._interrupted = True
            for loop in self._loops:
                loop.interrupt()

    def acknowledge_all(self) -> None:
        """Tell every robot that its last results arrived."""
        for robot, goal_ids in self._unacknowledged.items():
            try:
                self._fleet.acknowledge(robot, goal_ids)
            except NufleetError as error:
                _log.warning("%s keeps its last results until they expire: %s", robot, error)
        self._unacknowledged.clear()
