"""Runs motions on robots: sends each one, waits, fetches and later acknowledges its result."""

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


class Interrupted(Exception):  # noqa: N818 - not an error: the end was requested
    """The motions were asked to end before they were complete."""


class GoalRunner:
    """Runs motions on the robots of a fleet; many threads may use it at once.

    `interrupt`, called from another thread, ends all motions with the robots at rest.
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
        """Whether `interrupt` was called."""
        return self._interrupted

    @contextmanager
    def pursuing(self) -> Iterator[GoalLoop]:
        """Open a loop for errands, all of which `interrupt` ends as well."""
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
        """Return an errand that also accounts for the robot's earlier goals.

        It acknowledges their results and cancels the goals that were abandoned.

        Args:
            robot: Name of the robot that is to move.
            goal_id: Unique id of the goal; the same id with the same motion is the same goal.
            motion: Motion that the robot is to execute.
            on_ended: Callback that receives the end of the pursuit, on the loop's thread.
            on_accepted: Callback that receives the robot's acceptance, on the loop's thread.
            taken_before: Whether the robot accepted the goal from an earlier orchestrator.
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
        """Run a motion on a robot and return its result, also if the motion failed.

        Args:
            robot: Name of the robot that is to move.
            goal_id: Unique id of the goal; the same id with the same motion is the same goal.
            motion: Motion that the robot is to execute.

        Returns:
            The result with the measured samples, also of a motion that ended early.

        Raises:
            RefusedError: The robot refuses the goal; the error holds its reason.
            RobotLostError: The robot is gone and does not return, no longer knows the goal when it
                does, or is overdue.
            NoReplyError: The robot is heard but does not answer.
            MalformedMessageError: The reply cannot be decoded.
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
        """Wait until an errand's callback sets an event.

        Ctrl-C during the wait interrupts all errands and is raised once they have ended. A second
        Ctrl-C is raised at once: robots stop by themselves when this process has ended.
        """
        try:
            loop.wait_for(done)
        except KeyboardInterrupt:
            self.interrupt()
            loop.wait_for(done)
            raise

    def interrupt(self) -> None:
        """Bring all robots to rest at once; from then on no goal is sent."""
        with self._lock:
            self._interrupted = True
            for loop in self._loops:
                loop.interrupt()

    def acknowledge_all(self) -> None:
        """Acknowledge the last results of every robot, so that it may discard them."""
        for robot, goal_ids in self._unacknowledged.items():
            try:
                self._fleet.acknowledge(robot, goal_ids)
            except NufleetError as error:
                _log.warning("%s keeps its last results until they expire: %s", robot, error)
        self._unacknowledged.clear()
