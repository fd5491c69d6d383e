"""What an agent decides about its robot: the pure machines, the owners and the results together.

Called from many threads; one lock is held for moments only, so that a stop never waits.
"""

from __future__ import annotations

import hashlib
import threading
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from robot_agent import goal_machine, supervisor
from robot_agent.excitation import plan_excitation
from robot_agent.flight_plan import plan_flight
from robot_agent.goal_machine import Goal
from robot_agent.memory import Memory
from robot_agent.pace import HaltSwitch
from robot_agent.results import KeptResults
from shared.codec import MAX_BODY_BYTES, MAX_MESSAGE_BYTES
from shared.excitation import Excitation
from shared.messages import (
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
    RobotState,
    RobotStatus,
)
from shared.motions import Motion, MotionPlan
from shared.robot_spec import RobotSpec
from shared.strict import as_reason

MAX_RESULT_NUMBERS = (MAX_MESSAGE_BYTES - 2 * MAX_BODY_BYTES) // 8
"""A motion that measures more is refused: its result would not fit into one message."""

_NUMBERS_PER_AXIS = 16
"""No flight measures more per sample and axis, all its signals together."""


@dataclass(frozen=True)
class Assignment:
    """An accepted goal that is to be played, and the switch that ends it early."""

    goal: Goal
    motion: Motion
    plan: MotionPlan
    switch: HaltSwitch = field(default_factory=HaltSwitch)


class Decisions:
    """Says of every request and event what is to be done; `changed` is set when the state did."""

    def __init__(
        self,
        robot: str,
        boot_id: str,
        spec: RobotSpec,
        memory: Memory,
        *,
        state_names: tuple[str, ...] = (),
        realtime: float | None,
        changed: threading.Event,
    ) -> None:
        self._robot = robot
        self._boot_id = boot_id
        self._spec = spec
        self._memory = memory
        self._state_names = state_names
        self._realtime = realtime
        self._changed = changed
        self._lock = threading.Condition()
        self._supervision = supervisor.Supervision()
        self._goals = goal_machine.Goals()
        self._results = KeptResults()
        self._owners_alive: set[str] = set()
        self._shutting_down = False
        self._motion: Assignment | None = None
        self._resting = False
        self._progress = 0.0
        self._last_goal: str | None = None
        self._last_reason = ""
        self._robot_time_s = 0.0
        self._sequence = 0

    # Events.

    def owner_appeared(self, owner: str) -> None:
        """An orchestrator's liveliness token is there."""
        with self._lock:
            self._owners_alive.add(owner)
            self._lock.notify_all()

    def owner_lost(self, owner: str) -> None:
        """An orchestrator's liveliness token disappeared; its motion ends."""
        with self._lock:
            self._owners_alive.discard(owner)
            self._supervise(supervisor.OwnerLost(owner))

    def wait_for_owner(self, owner: str, *, timeout_s: float) -> bool:
        """Wait until an orchestrator's token is there; return whether it is."""
        with self._lock:
            return self._lock.wait_for(lambda: owner in self._owners_alive, timeout_s)

    def stop(self, order: supervisor.StopOrder) -> None:
        """Stop: the motion in progress ends, and none begins until a release."""
        with self._lock:
            self._supervise(supervisor.StopOrdered(order))

    def shut_down(self) -> None:
        """End the motion in progress and accept no more goals."""
        with self._lock:
            self._shutting_down = True
            if self._motion is not None:
                self._motion.switch.halt(Outcome.ABORTED, "the agent is shutting down")
            self._changed.set()

    # Requests.

    def take(self, request: GoalRequest) -> tuple[GoalAccepted | Refusal, Assignment | None]:
        """Accept or refuse a goal; return the answer, and the motion that is to begin.

        A goal that is known already is accepted again and moves nothing.

        Raises:
            RefusedError: the motion is outside the robot's limits.
        """
        self.forget(request.acknowledges)
        digest = _digest(request.motion)
        with self._lock:
            answer = self._submitted(request, digest)[1]
        if isinstance(answer, Refusal):
            return answer, None
        # Planning takes a while and a stop must not wait for it, so what was looked at before the
        # plan is looked at again after it. The same request gives the same plan every time.
        plan = self._planned(request.motion)
        per_sample = 2
        if not isinstance(request.motion, Excitation):
            per_sample = _NUMBERS_PER_AXIS * len(self._spec.axes)
        if plan.samples * per_sample > MAX_RESULT_NUMBERS:
            most = MAX_RESULT_NUMBERS // per_sample
            too_long = f"{plan.samples} samples are too many; at most {most}"
            return Refusal(code="duration", reason=too_long), None
        motion = None
        with self._lock:
            self._goals, answer = self._submitted(request, digest)
            if isinstance(answer, Refusal):
                return answer, None
            if answer.new:
                motion = self._motion = Assignment(answer.goal, request.motion, plan)
                self._resting, self._progress = False, 0.0
                self._supervise(supervisor.MotionBegan(request.owner))
        accepted = GoalAccepted(
            goal_id=request.goal_id,
            boot_id=self._boot_id,
            plan=plan,
            wall_duration_s=self._wall_duration_s(plan),
        )
        return accepted, motion

    def refusal_to_change(self) -> Refusal | None:
        """Return why what the robot flies with may not be changed now; None when it may."""
        with self._lock:
            if self._motion is None:
                return None
            return Refusal(code="busy", reason=f"running goal {self._motion.goal.goal_id}")

    def cancel(self, goal_id: str) -> Refusal | None:
        """End a goal's motion early; return why not."""
        with self._lock:
            refusal = goal_machine.cancel(self._goals, goal_id)
            if refusal is None and self._motion is not None:
                self._motion.switch.halt(Outcome.CANCELLED, "cancelled")
            self._changed.set()
            return refusal

    def result(self, goal_id: str) -> GoalResult | Refusal:
        """Return how a goal ended, or why there is nothing to return."""
        with self._lock:
            result = self._results.get(goal_id)
            goal = self._goals.known.get(goal_id)
        if result is not None:
            return result
        if goal is None:
            return Refusal(code="unknown-goal", reason=f"goal {goal_id} is not known here")
        if goal.outcome is None:
            return Refusal(code="not-finished", reason=f"goal {goal_id} is still running")
        return Refusal(code="result-gone", reason=f"the result of {goal_id} was let go already")

    def forget(self, goal_ids: Iterable[str]) -> None:
        """Let results go that have arrived."""
        with self._lock:
            self._results.forget(goal_ids)

    def release(self, sender: str) -> Refusal | None:
        """End a stop; return why not. A fault stays until the robot is connected anew."""
        with self._lock:
            if self._goals.running is not None:
                return Refusal(code="busy", reason="still coming to rest; release it in a moment")
            self._supervise(supervisor.ReleaseOrdered(sender))
            self._last_reason = ""
            return None

    # What becomes of motions.

    def progressed(self, motion: Assignment, samples: int) -> None:
        """So many samples of a motion have been played."""
        whole = motion.plan.duration_s / motion.plan.sample_time_s
        self._progress = min(1.0, samples / whole)

    def resting(self) -> None:
        """The motion in progress has been played and the robot is coming to rest."""
        with self._lock:
            self._resting = True
            self._changed.set()

    def ended(self, result: GoalResult, fault: str | None) -> None:
        """The motion in progress is over; `fault` says why the robot cannot be trusted now."""
        with self._lock:
            self._results.add(result)
            self._goals = goal_machine.end(self._goals, result.goal_id, result.outcome)
            self._motion = None
            self._last_goal = result.goal_id
            self._last_reason = result.reason
            self._robot_time_s += len(result.reference) * result.plan.sample_time_s
            self._supervise(supervisor.MotionEnded(fault))

    @property
    def fault(self) -> str | None:
        """Why the robot has to be connected anew; None when it is well."""
        return self._supervision.fault

    def reconnected(self, fault: str | None) -> None:
        """The robot was connected anew, or why it could not be."""
        with self._lock:
            self._supervise(supervisor.Reconnected(fault))

    def state(self) -> RobotState:
        """Return what is to be published now."""
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
                reason=as_reason(reason),
                last_goal_id=self._last_goal,
                robot_time_s=self._robot_time_s,
            )

    # With the lock held.

    def _submitted(
        self, request: GoalRequest, digest: str
    ) -> tuple[goal_machine.Goals, goal_machine.Accepted | Refusal]:
        goal_id, owner = request.goal_id, request.owner
        if goal_machine.recognise(self._goals, goal_id=goal_id, digest=digest) is None:
            if self._shutting_down:
                return self._goals, Refusal(code="shutting-down", reason="this agent is ending")
            alive = owner in self._owners_alive
            refusal = supervisor.refusal_to_start(self._supervision, owner=owner, owner_alive=alive)
            if refusal is not None:
                return self._goals, refusal
        return goal_machine.submit(self._goals, goal_id=goal_id, owner=owner, digest=digest)

    def _supervise(self, event: supervisor.Event) -> None:
        self._supervision, halt = supervisor.supervise(self._supervision, event)
        if halt is not None and self._motion is not None:
            self._motion.switch.halt(halt.outcome, halt.reason)
        self._changed.set()

    def _status(self) -> tuple[RobotStatus, str]:
        if self._motion is not None:
            order = self._motion.switch.order
            if order is not None:
                return RobotStatus.RESTING, order[1]
            return (RobotStatus.RESTING if self._resting else RobotStatus.RUNNING), ""
        if self._supervision.fault is not None:
            return RobotStatus.FAULT, self._supervision.fault
        stop = self._supervision.stop
        if stop is not None:
            return RobotStatus.STOPPED, f"stopped by {stop.sender}: {stop.reason}"
        return RobotStatus.IDLE, self._last_reason

    def _planned(self, motion: Motion) -> MotionPlan:
        if isinstance(motion, Excitation):
            return plan_excitation(motion, self._spec, robot=self._robot)
        return plan_flight(motion, self._spec, self._state_names, self._memory, self._robot)

    def _wall_duration_s(self, plan: MotionPlan) -> float:
        if not self._spec.simulated:
            return plan.duration_s
        return 0.0 if self._realtime is None else plan.duration_s / self._realtime


def _digest(motion: Motion) -> str:
    """Return a hash of all that a motion asks for."""
    arrays: list[np.ndarray] = []
    body = motion.model_dump_json(context=arrays)
    digest = hashlib.sha256(body.encode())
    for array in arrays:
        digest.update(f"{array.shape}".encode())
        digest.update(np.ascontiguousarray(array).tobytes())
    return digest.hexdigest()
