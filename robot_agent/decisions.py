"""An agent's decisions about its robot: combines the pure machines, the owners and the results.

Its methods are called from many threads. One lock protects the state and is held for moments only,
so that a stop never waits. A fact that has to survive the process is in the journal before it is
confirmed to a sender; waiting for the disk happens without that lock.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.journal.unrecorded import Unrecorded
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.planner import Planner, digest
from nufleet.robot_agent.rules import goal_machine, ownership, supervisor
from nufleet.robot_agent.rules.goal_machine import Goal
from nufleet.robot_agent.rules.kept_results import KeptResults
from nufleet.robot_agent.rules.ownership import Commander, Waiting
from nufleet.shared.robots.health import Health
from nufleet.shared.wire.messages import (
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
    RobotState,
    RobotStatus,
)
from nufleet.shared.wire.motions import Motion, MotionPlan

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Assignment:
    """An accepted goal that is to be played."""

    goal: Goal
    """The goal."""

    motion: Motion
    """Motion that the goal requests."""

    plan: MotionPlan
    """Plan of the motion within the robot's limits."""

    switch: HaltSwitch = field(default_factory=HaltSwitch)
    """Switch that ends the motion early."""


class Decisions:
    """Decides the consequence of every request and event.

    It sets the event `changed` whenever the state to be published has changed.
    """

    def __init__(
        self,
        boot_id: str,
        planner: Planner,
        journal: Journal | Unrecorded,
        changed: threading.Event,
        clock: Callable[[], float] = time.monotonic,
        *,
        may_last: Callable[[MotionPlan], Refusal | None] = lambda plan: None,
    ) -> None:
        """Begin in the state that the journal holds from earlier agent processes.

        Args:
            boot_id: Id of this agent process.
            planner: Planner of the robot's motions.
            journal: Journal of the robot.
            changed: Event to set when the state to be published has changed.
            clock: Function that returns the time in s, which never decreases.
            may_last: Function that returns why a motion may not begin now, because of how long it
                takes; None when it may.
        """
        self._may_last = may_last
        self._robot = planner.robot
        self._boot_id = boot_id
        self._planner = planner
        self._journal = journal
        self._changed = changed
        self._clock = clock
        self._lock = threading.Condition()
        # Each is held while the disk writes, so that memory and journal agree.
        self._taking = threading.Lock()
        self._stopping = threading.Lock()
        found = journal.remembrance
        self._supervision = supervisor.Supervision(stop=found.stop)
        self._goals = found.goals
        owner = found.owner
        self._commander = None if owner is None else Commander(owner.owner, owner.epoch)
        self._waiting: Waiting | None = None
        self._last_goal = found.lost[-1] if found.lost else None
        self._last_reason = (
            f"the previous agent process ended during {self._last_goal}" if found.lost else ""
        )
        self._results = KeptResults()
        self._owners_alive: set[str] = set()
        self._health: Health | None = None
        self._stops = 0
        self._cutting = False
        self._shutting_down = False
        self._motion: Assignment | None = None
        self._resting = self._at_rest = False
        self._progress = 0.0
        self._robot_time_s = 0.0
        self._sequence = 0

    # Events.

    def owner_appeared(self, owner: str) -> None:
        """Record that an orchestrator's liveliness token appeared."""
        with self._lock:
            self._owners_alive.add(owner)
            self._lock.notify_all()

    def owner_lost(self, owner: str) -> None:
        """Record that an orchestrator's liveliness token disappeared; its motion ends."""
        with self._lock:
            self._owners_alive.discard(owner)
            self._supervise(supervisor.OwnerLost(owner))

    def wait_for_owner(self, owner: str, *, timeout_s: float) -> bool:
        """Wait for an orchestrator's token; return whether it is present."""
        with self._lock:
            return self._lock.wait_for(lambda: owner in self._owners_alive, timeout_s)

    def stop(self, order: supervisor.StopOrder, *, kill: bool = False) -> bool:
        """Stop the robot: the motion in progress ends, and none begins until a release.

        This does not wait for the disk; `store_stop` then makes the stop outlast the process.

        Args:
            order: The order.
            kill: Whether its motors will be cut too, so that a release in progress may not end.

        Returns:
            Whether the robot is stopped: not by another copy of a stop that was released since.
        """
        with self._lock:
            copy = supervisor.is_copy(self._supervision, order)
            if copy and self._supervision.stop is None:
                return False
            if kill or not copy:
                self._stops += 1
            self._supervise(supervisor.StopOrdered(order))
        return True

    def store_stop(self) -> None:
        """Store the stop in force, if there is one; raises JournalError."""
        with self._stopping:
            with self._lock:
                order = self._supervision.stop
            if order is not None:
                self._journal.stopped(order)

    def cutting(self) -> None:
        """Record that the motors are being cut, until `cut`; no release is taken meanwhile."""
        with self._lock:
            self._cutting = True

    def cut(self, fault: str | None) -> None:
        """Record that the motors have been cut, which is a fault; None when that failed."""
        with self._lock:
            self._cutting = False
            if fault is not None:
                self._supervise(supervisor.FaultFound(fault))

    def broke(self, fault: str) -> None:
        """Record that the robot cannot be trusted with another motion; the present one ends."""
        with self._lock:
            self._supervise(supervisor.FaultFound(fault))

    def reported(self, health: Health | None, unfit: str | None) -> None:
        """Record the robot's health, and why it may not move; None when it may."""
        with self._lock:
            self._health = health
            if unfit != self._supervision.unfit:
                self._supervise(supervisor.HealthReported(unfit))

    def shut_down(self) -> None:
        """End the motion in progress and accept no more goals."""
        with self._lock:
            self._shutting_down = True
            if self._motion is not None:
                self._motion.switch.halt(Outcome.ABORTED, "the agent is shutting down")
            self._changed.set()

    # Requests.

    def take(self, request: GoalRequest) -> tuple[GoalAccepted | Refusal, Assignment | None]:
        """Accept or refuse a goal.

        A goal that is already known is accepted again and moves nothing.

        Returns:
            The answer to the sender, and the motion to begin now; None when none is to begin.

        Raises:
            RefusedError: The motion is outside the robot's limits.
        """
        with self._taking:
            return self._taken(request)

    def change(self, sender: Commander) -> Refusal | None:
        """Return why a sender may not change the robot's learned models now; None when it may.

        A sender that may commands the robot from now on.

        Raises:
            JournalError: The new commander cannot be stored.
        """
        with self._taking:
            with self._lock:
                refusal = self._refusal_to_command(sender)
                if refusal is None and self._motion is not None:
                    running = self._motion.goal.goal_id
                    refusal = Refusal(code="busy", reason=f"running goal {running}")
            if refusal is None:
                self._follow(sender)
        return refusal

    def cancel(self, goal_id: str, sender: Commander) -> Refusal | None:
        """End a goal's motion early.

        A goal that has not arrived yet is refused when it does, so that a sender whose cancellation
        is confirmed knows that the goal will move nothing.

        Returns:
            Why the goal cannot be cancelled; None when it is.

        Raises:
            JournalError: The cancellation of a goal that has not arrived cannot be stored.
        """
        with self._taking:
            with self._lock:
                # The orchestrator that began a motion may end it even if it has lost its lease.
                refusal = None
                if self._supervision.motion_owner != sender.owner:
                    refusal = self._refusal_to_command(sender)
                refusal = refusal or goal_machine.cancel(self._goals, goal_id)
                if refusal is not None:
                    return refusal
                if self._motion is not None and self._motion.goal.goal_id == goal_id:
                    self._motion.switch.halt(Outcome.CANCELLED, "cancelled")
                    self._changed.set()
                    return None
                self._goals = goal_machine.forgo(self._goals, goal_id, sender.owner)
            self._journal.forgone(goal_id)
        return None

    def knows(self, goal_id: str) -> bool:
        """Return whether a goal came before, so that it moves nothing when it comes again."""
        with self._lock:
            return goal_id in self._goals.known

    def result(self, goal_id: str) -> GoalResult | Refusal:
        """Return how a goal ended, or why no result can be returned."""
        with self._lock:
            result = self._results.get(goal_id)
            goal = self._goals.known.get(goal_id)
        if result is not None:
            return result
        if goal is None:
            return Refusal(code="unknown-goal", reason=f"the robot does not know goal {goal_id}")
        if goal.outcome is None:
            return Refusal(code="not-finished", reason=f"goal {goal_id} is still running")
        return self._journal.result(goal_id) or Refusal(
            code="result-gone", reason=f"the result of {goal_id} has already been deleted"
        )

    def acknowledge(self, goal_ids: Iterable[str], sender: Commander) -> Refusal | None:
        """Drop results that have arrived; return why this is refused, or None.

        Raises:
            JournalError: The change cannot be stored.
        """
        with self._lock:
            refusal = self._refusal_to_command(sender)
        if refusal is None:
            self._forget(goal_ids)
        return refusal

    def release(self, sender: str) -> Refusal | None:
        """End a stop; a fault remains until the robot is reconnected.

        Returns:
            Why the robot cannot be released now; None when it is.

        Raises:
            JournalError: The release cannot be stored; the robot stays stopped.
        """
        with self._stopping:
            with self._lock:
                stops = self._stops
                if self._cutting or self._goals.running is not None:
                    now = "its motors are being cut" if self._cutting else "it is coming to rest"
                    return Refusal(code="busy", reason=f"{now}; release it in a moment")
            self._journal.released(sender)
            with self._lock:
                if self._stops != stops:
                    # The sender of that later stop does not know of this release, so the stop
                    # stands; its `store_stop`, which waits for us, stores it again.
                    return Refusal(code="stopped", reason="it has just been stopped again")
                self._supervise(supervisor.ReleaseOrdered(sender))
                self._last_reason = ""
                self._changed.set()
        return None

    # Progress and end of motions.

    def progressed(self, motion: Assignment, samples: int) -> None:
        """Record the number of samples of a motion that have been played."""
        whole = motion.plan.duration_s / motion.plan.sample_time_s
        self._progress = min(1.0, samples / whole)

    def resting(self) -> None:
        """Record that the motion in progress has been played and the robot is coming to rest."""
        with self._lock:
            self._resting = True
            self._changed.set()

    def at_rest(self) -> None:
        """Record that the robot is at rest after the motion in progress, which `ended` ends."""
        with self._lock:
            self._at_rest = True
            if self._supervision.stop is not None:
                self._changed.set()

    def ended(self, result: GoalResult, fault: str | None) -> None:
        """Record the end of the motion in progress.

        Args:
            result: Result of the motion's goal.
            fault: Why the robot cannot be trusted with another motion; None when it can.
        """
        try:
            self._journal.ended(result)
        except JournalError as error:
            # The motion has ended all the same. The next agent process will report the goal as
            # lost and will not play it again.
            _log.error("the end of %s could not be stored: %s", result.goal_id, error)
        with self._lock:
            self._results.add(result)
            self._goals = goal_machine.end(self._goals, result.goal_id, result.outcome)
            self._motion = None
            self._last_goal = result.goal_id
            self._last_reason = result.reason
            self._robot_time_s += len(result.reference) * result.plan.sample_time_s
            self._supervise(supervisor.MotionEnded(fault))
            self._changed.set()

    @property
    def commander(self) -> Commander | None:
        """Orchestrator that last commanded the robot under a lease; None when there was none."""
        return self._commander

    @property
    def running(self) -> str | None:
        """Id of the goal in progress; None at rest."""
        return self._goals.running

    @property
    def fault(self) -> str | None:
        """Why the robot has to be reconnected; None when it has no fault."""
        return self._supervision.fault

    @property
    def stopped(self) -> bool:
        """Whether a stop is in force."""
        return self._supervision.stop is not None

    @property
    def stops(self) -> int:
        """Number of stops that have arrived."""
        return self._stops

    def reconnected(self, fault: str | None, *, stops: int) -> str | None:
        """Record the end of an attempt to reconnect the robot.

        Args:
            fault: Why it failed; None when the robot is connected.
            stops: Number of stops that had arrived when it began. The motors may have been cut by
                a later one, so that the robot has to be released and reconnected once more.

        Returns:
            Why the robot still cannot be trusted; None when it can be.
        """
        with self._lock:
            if fault is None and stops != self._stops:
                fault = "it was stopped while it was being reconnected"
            self._supervise(supervisor.Reconnected(fault))
            return fault

    def state(self) -> RobotState:
        """Return the state to publish now, with the next sequence number."""
        with self._lock:
            self._sequence += 1
            status, reason = self._status()
            return RobotState(
                robot=self._robot,
                boot_id=self._boot_id,
                sequence=self._sequence,
                status=status,
                goal_id=self._goals.running,
                progress=self._progress,
                reason=reason,
                last_goal_id=self._last_goal,
                robot_time_s=self._robot_time_s,
                health=self._health,
            )

    # Taking a goal, one at a time.

    def _taken(self, request: GoalRequest) -> tuple[GoalAccepted | Refusal, Assignment | None]:
        sha256 = digest(request.motion)
        with self._lock:
            answer = self._submitted(request, sha256)[1]
        if isinstance(answer, Refusal):
            return answer, None
        self._forget_quietly(request.acknowledges)
        # Planning takes a while and a stop must not wait for it. It is therefore done without the
        # lock, and the checks made before it are repeated after it.
        plan = None if answer.new else self._known_plan(request.goal_id)
        plan = plan or self._planner.plan(request.motion)
        if answer.new:
            too_long = self._may_last(plan)
            if too_long is not None:
                return too_long, None
        motion = None
        with self._lock:
            self._goals, answer = self._submitted(request, sha256)
            if isinstance(answer, Refusal):
                return answer, None
            if answer.new:
                motion = self._motion = Assignment(answer.goal, request.motion, plan)
                self._resting = self._at_rest = False
                self._progress = 0.0
                self._supervise(supervisor.MotionBegan(request.owner))
        # From here on, a stop finds this motion and halts it, although it has not begun.
        try:
            self._follow(_commander(request))
            if motion is not None:
                self._journal.accepted(motion.goal, plan, self._boot_id)
        except JournalError as error:
            if motion is not None:
                self._take_back(motion)
            return Refusal(code="journal", reason=str(error)), None
        accepted = GoalAccepted(
            goal_id=request.goal_id,
            boot_id=self._boot_id,
            plan=plan,
            wall_duration_s=self._planner.wall_duration_s(plan),
        )
        return accepted, motion

    def _forget(self, goal_ids: Iterable[str]) -> None:
        goal_ids = tuple(goal_ids)
        self._journal.acknowledged(goal_ids)
        with self._lock:
            self._results.forget(goal_ids)

    def _forget_quietly(self, goal_ids: tuple[str, ...]) -> None:
        try:
            self._forget(goal_ids)
        except JournalError as error:
            # This is no reason to refuse the goal in the same request, which may already run.
            _log.warning("acknowledged results could not be deleted: %s", error)

    def _known_plan(self, goal_id: str) -> MotionPlan | None:
        """Return the plan of a goal that is known; None when it was dropped with its result.

        A new plan might differ, since the robot may have learned something in the meantime.
        """
        with self._lock:
            if self._motion is not None and self._motion.goal.goal_id == goal_id:
                return self._motion.plan
        result = self.result(goal_id)
        return result.plan if isinstance(result, GoalResult) else None

    def _take_back(self, motion: Assignment) -> None:
        """Remove a goal that could not be stored and was not confirmed to its sender."""
        with self._lock:
            self._goals = goal_machine.take_back(self._goals, motion.goal.goal_id)
            self._motion = None
            self._supervise(supervisor.MotionEnded())

    def _follow(self, sender: Commander) -> None:
        """Store a sender's epoch before anything is done under it; raises JournalError."""
        if ownership.takes_over(self._commander, sender):
            self._journal.owned(sender.owner, sender.epoch)
            with self._lock:
                self._commander = sender

    # With the lock held.

    def _refusal_to_command(self, sender: Commander) -> Refusal | None:
        held, moving_for = self._commander, self._supervision.motion_owner
        return ownership.refusal_to_command(
            held,
            sender,
            held_alive=held is not None and held.owner in self._owners_alive,
            moving_for=moving_for if moving_for in self._owners_alive else None,
        )

    def _submitted(
        self, request: GoalRequest, sha256: str
    ) -> tuple[goal_machine.Goals, goal_machine.Accepted | Refusal]:
        goal_id, owner, sender = request.goal_id, request.owner, _commander(request)
        submitted = goal_machine.submit(self._goals, goal_id=goal_id, owner=owner, digest=sha256)
        answer = self._refusal_to_command(sender) or submitted[1]
        # An orchestrator also waits for the end of a motion whose owner is gone.
        self._waiting = ownership.waiting_next(
            self._waiting,
            sender,
            answer if isinstance(answer, Refusal) else None,
            held=self._commander,
            alive=self._owners_alive,
            now_s=self._clock(),
        )
        if answer is not submitted[1]:
            return self._goals, answer
        if goal_machine.recognise(self._goals, goal_id=goal_id, digest=sha256) is None:
            if self._shutting_down:
                return self._goals, Refusal(
                    code="shutting-down", reason="this agent is shutting down"
                )
            alive = owner in self._owners_alive
            refusal = ownership.refusal_to_begin(
                self._waiting, sender
            ) or supervisor.refusal_to_start(self._supervision, owner=owner, owner_alive=alive)
            if refusal is not None:
                return self._goals, refusal
        return submitted

    def _supervise(self, event: supervisor.Event) -> None:
        before, motion = self._supervision, self._motion
        self._supervision, halt = supervisor.supervise(before, event)
        halts = halt is not None and motion is not None and motion.switch.order is None
        if halt is not None and motion is not None:
            motion.switch.halt(halt.outcome, halt.reason)
        # Each state is a message, and a stop comes in several copies.
        if halts or self._supervision != before:
            self._changed.set()

    def _status(self) -> tuple[RobotStatus, str]:
        stop = self._supervision.stop
        # A stopped robot tells that it is at rest before its result is on the disk.
        if self._motion is not None and not (self._at_rest and stop is not None):
            order = self._motion.switch.order
            if order is not None:
                return RobotStatus.RESTING, order[1]
            return (RobotStatus.RESTING if self._resting else RobotStatus.RUNNING), ""
        if self._supervision.fault is not None:
            return RobotStatus.FAULT, self._supervision.fault
        if stop is not None:
            return RobotStatus.STOPPED, f"stopped by {stop.sender}: {stop.reason}"
        return RobotStatus.IDLE, self._supervision.unfit or self._last_reason


def _commander(request: GoalRequest) -> Commander:
    return Commander(request.owner, request.epoch)
