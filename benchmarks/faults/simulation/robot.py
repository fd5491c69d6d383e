"""A robot and the agent process beside it: the product's decisions in a simulated process."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import Any

import numpy as np

from benchmarks.faults.simulation.history import History, Motion, Violation
from benchmarks.faults.simulation.network import Network, Node, OnAnswer
from benchmarks.faults.simulation.world import World
from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.journal import Remembrance, lost_result
from nufleet.robot_agent.journal.ledger import (
    Accepted,
    Acknowledged,
    Ended,
    JournalError,
    Ledger,
    Owned,
    Record,
    Released,
    Stopped,
)
from nufleet.robot_agent.motion.excitation import peak_velocity_and_acceleration, reference_of
from nufleet.robot_agent.motion.pace import GAP_MAX_S
from nufleet.robot_agent.network.heartbeat import HEARTBEAT_S
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules.freezes import Freezes
from nufleet.robot_agent.rules.goal_machine import Goal, Goals
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import (
    Description,
    Done,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
)
from nufleet.shared.wire.motions import Motion as AskedMotion
from nufleet.shared.wire.motions import MotionPlan

BAD_SENSOR = "its sensor reads 0"
_PLANS: dict[tuple[float, AskedMotion], MotionPlan] = {}
_NO_SAMPLES = np.empty(0)


class Disk:
    """The disk of a robot, which outlives its agents: the journal's ledger and the kept results."""

    def __init__(self) -> None:
        self.ledger = Ledger()
        self.results: dict[str, GoalResult] = {}
        self.full = False


class DiskJournal:
    """A `Journal` on a simulated disk: a record is stored whole or refused."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk
        lost = tuple(known.goal.goal_id for known in disk.ledger.running)
        for known in disk.ledger.running:
            result = lost_result(known)
            disk.results[known.goal.goal_id] = result
            disk.ledger.apply(_ended(result))
        goals = {goal_id: known.goal for goal_id, known in disk.ledger.goals.items()}
        self.remembrance = Remembrance(
            Goals(MappingProxyType(goals)), disk.ledger.stop, disk.ledger.owner, lost, None
        )

    def accepted(self, goal: Goal, plan: MotionPlan, boot_id: str) -> None:
        self._append(
            Accepted.model_construct(
                goal_id=goal.goal_id,
                owner=goal.owner,
                digest=goal.digest,
                boot_id=boot_id,
                plan=plan,
            )
        )

    def ended(self, result: GoalResult) -> bool:
        self._append(_ended(result))
        self._disk.results[result.goal_id] = result
        return True

    def forgone(self, goal_id: str) -> None:
        self._append(
            Ended.model_construct(
                goal_id=goal_id, outcome=Outcome.CANCELLED, sha256=None, size_bytes=0
            )
        )

    def acknowledged(self, goal_ids: Iterable[str]) -> None:
        self._append(Acknowledged.model_construct(goal_ids=tuple(goal_ids)))

    def stopped(self, order: StopOrder) -> None:
        self._append(Stopped.model_construct(sender=order.sender, reason=order.reason))

    def released(self, sender: str) -> None:
        self._append(Released.model_construct(sender=sender))

    def owned(self, owner: str, epoch: int) -> None:
        self._append(Owned.model_construct(owner=owner, epoch=epoch))

    def result(self, goal_id: str) -> GoalResult | None:
        return self._disk.results.get(goal_id)

    def close(self) -> None:
        """Do nothing: no file is open."""

    def _append(self, record: Record) -> None:
        if self._disk.ledger.says_already(record):
            return
        if self._disk.full:
            raise JournalError("no space left on the device")
        for goal_id in self._disk.ledger.apply(record):
            self._disk.results.pop(goal_id, None)


def _ended(result: GoalResult) -> Ended:
    return Ended.model_construct(
        goal_id=result.goal_id, outcome=result.outcome, sha256="0" * 64, size_bytes=1
    )


def _result(
    goal_id: str, boot_id: str, outcome: Outcome, reason: str, plan: MotionPlan, samples: int
) -> GoalResult:
    zeros = np.zeros(samples) if samples else _NO_SAMPLES
    return GoalResult.model_construct(
        goal_id=goal_id,
        boot_id=boot_id,
        outcome=outcome,
        reason=reason,
        plan=plan,
        reference=zeros,
        response=zeros,
        details=None,
    )


class CachedPlanner(Planner):
    """The product's planner with a cache: no motion is planned twice."""

    def plan(self, motion: AskedMotion) -> MotionPlan:
        key = (self.spec.duration_max_s, motion)
        if key not in _PLANS:
            _PLANS[key] = super().plan(motion)
            self._check_limits(_PLANS[key])
        return _PLANS[key]

    def _check_limits(self, plan: MotionPlan) -> None:
        """Check every sample of a plan's reference, from rest to rest; raises Violation."""
        if not isinstance(plan, ExcitationPlan):
            raise Violation(f"{plan} is not what a study asks for")
        reference, (axis,) = reference_of(plan), self.spec.axes
        velocity, acceleration = peak_velocity_and_acceleration(reference, plan.sample_time_s)
        found = (float(np.abs(reference).max()), velocity, acceleration)
        limits = (axis.amplitude_max, axis.velocity_max, axis.acceleration_max)
        if any(value > limit for value, limit in zip(found, limits, strict=True)):
            raise Violation(f"a plan asks for {found} where {limits} is allowed: {plan}")


@dataclass
class Playing:
    """The motion in progress."""

    assignment: Assignment
    """Accepted goal that is played."""

    record: Motion
    """Entry of the motion in the history."""

    ends_s: float
    """Time at which its last sample has been played."""

    resting: bool = False
    """Whether the robot is coming to rest."""


class _Changed:
    """Substitute for the event that `Decisions` sets when its state is to be published."""

    def __init__(self, agent: SimulatedAgent) -> None:
        self._agent = agent

    def set(self) -> None:
        self._agent.change()


class SimulatedRobot:
    """One robot: its spec, its disk, and the agent that serves it now, if any."""

    def __init__(
        self, world: World, network: Network, history: History, name: str, spec: RobotSpec
    ) -> None:
        self.world, self.network, self.history = world, network, history
        self.name, self.spec = name, spec
        self.disk = Disk()
        self.bad_sensor = 0
        self.states_lost_until_s = 0.0
        self.states_late: tuple[float, float] = (0.0, 0.0)
        self.lives = 0
        self.agent: SimulatedAgent | None = None
        self.listeners: list[Any] = []
        self.start()

    def start(self) -> None:
        """Start an agent unless one is running."""
        if self.agent is None:
            self.lives += 1
            self.agent = SimulatedAgent(self)

    def kill(self, back_after_s: float) -> None:
        """Kill the agent; its robot comes to rest by itself, and another agent starts later."""
        if self.agent is None:
            return
        self.history.tell(self.world.now_s, f"the agent of {self.name} is killed")
        self.agent.die()
        self.agent = None
        self.world.after(back_after_s, self.start)


class SimulatedAgent:
    """One agent process."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot, self._world, self._history = robot, robot.world, robot.history
        self.boot_id = f"{robot.name}-boot-{robot.lives}"
        planner = CachedPlanner(robot.name, robot.spec, (), Memory(None), 1.0)
        self._publishing = False
        self._playing: Playing | None = None
        self._motion: Assignment | None = None
        self._freezes = Freezes(self._world.now_s)
        journal: Any = DiskJournal(robot.disk)
        changed: Any = _Changed(self)
        self.decisions = Decisions(
            self.boot_id, planner, journal, changed, lambda: self._world.now_s
        )
        self.node: Node = robot.network.join("robot", robot.name, self)
        self._beat()

    def die(self) -> None:
        """End the process at once; without references its robot comes to rest."""
        self._robot.network.end(self.node)
        if self._playing is not None:
            self._playing.record.ended_s = self._world.now_s

    # Events from the network.

    def told(self, kind: str, name: str, alive: bool) -> None:
        if kind == "orchestrator":
            (self.decisions.owner_appeared if alive else self.decisions.owner_lost)(name)
            self._look()

    def asked(self, question: str, body: Any, answer: OnAnswer) -> None:
        try:
            said = self._answer(question, body)
        except RefusedError as error:
            said = Refusal(code=error.code, reason=error.reason)
        except JournalError as error:
            said = Refusal(code="journal", reason=str(error))
        answer(Done() if said is None else said)
        self._look()

    def _answer(self, question: str, body: Any) -> Any:
        decisions = self.decisions
        match question:
            case "goal":
                return self._take(body)
            case "result":
                return decisions.result(body)
            case "cancel":
                goal_id, sender = body
                return decisions.cancel(goal_id, sender)
            case "acknowledge":
                goal_ids, sender = body
                return decisions.acknowledge(goal_ids, sender)
            case "stop":
                decisions.stop(StopOrder(body, "smoke"))
                decisions.store_stop()
                return None
            case "release":
                return decisions.release(body)
            case "describe":
                return self._described()
        raise AssertionError(question)

    def _described(self) -> Description:
        held = self.decisions.commander or Commander("none", 0)
        return Description.model_construct(
            robot=self._robot.name,
            boot_id=self.boot_id,
            spec=self._robot.spec,
            owner=held.owner if held.epoch else None,
            epoch=held.epoch,
        )

    def _take(self, request: GoalRequest) -> Any:
        refusal = self._freezes.refusal(self._world.now_s)
        if refusal is not None and not self.decisions.knows(request.goal_id):
            return refusal
        accepted, motion = self.decisions.take(request)
        if motion is not None:
            self._begin(motion)
        return accepted

    # Motions.

    def _begin(self, assignment: Assignment) -> None:
        goal = assignment.goal
        if assignment.switch.order is not None:
            self._ended(assignment, 0, *assignment.switch.order)
            return
        record = self._history.began(self._world.now_s, self._robot.name, goal.goal_id, goal.owner)
        playing = self._playing = Playing(
            assignment, record, self._world.now_s + assignment.plan.duration_s
        )
        self._world.at(playing.ends_s, lambda: self.node.do(lambda: self._played(playing)))

    def _played(self, playing: Playing) -> None:
        self._note_gap()
        if self._playing is playing and not playing.resting:
            self._rest(playing)

    def _look(self) -> None:
        """Bring the robot to rest if its motion has been halted."""
        playing = self._playing
        if playing is None or playing.resting or playing.assignment.switch.order is None:
            return
        self._rest(playing)

    def _rest(self, playing: Playing) -> None:
        playing.resting = True
        playing.record.resting_s = self._world.now_s
        self.decisions.resting()
        self._world.after(
            self._world.between(0.01, 1.5), lambda: self.node.do(lambda: self._at_rest(playing))
        )

    def _at_rest(self, playing: Playing) -> None:
        assignment = playing.assignment
        self._playing = None
        playing.record.ended_s = self._world.now_s
        order = assignment.switch.order
        plan = assignment.plan
        if order is not None:
            flown_s = playing.record.resting_s - playing.record.began_s  # type: ignore[operator]
            samples = min(int(flown_s / plan.sample_time_s), plan.samples)
            self._ended(assignment, samples, *order)
            return
        bad = self._robot.bad_sensor > 0
        self._robot.bad_sensor -= bad
        playing.record.completed = not bad
        self._ended(assignment, plan.samples, Outcome.COMPLETED, BAD_SENSOR if bad else "")

    def _ended(self, assignment: Assignment, samples: int, outcome: Outcome, reason: str) -> None:
        goal_id = assignment.goal.goal_id
        self._history.tell(self._world.now_s, f"{self._robot.name} ended {goal_id}: {outcome}")
        result = _result(goal_id, self.boot_id, outcome, reason, assignment.plan, samples)
        self.decisions.ended(result, None)

    # Heartbeats.

    def _beat(self) -> None:
        self._note_gap()
        self.node.frozen_since_s = 0.0
        self._freezes.beat(self._world.now_s)
        self._publish()
        self._world.after(HEARTBEAT_S, lambda: self.node.do(self._beat))

    def _note_gap(self) -> None:
        """End a motion whose samples are too far apart, as `Pace` does."""
        gap_s = self._world.now_s - self.node.frozen_since_s
        if self.node.frozen_since_s and gap_s > GAP_MAX_S and self._playing is not None:
            self._playing.assignment.switch.halt(Outcome.ABORTED, f"nothing for {gap_s:.1f} s")
            self._look()

    def change(self) -> None:
        """Publish the state soon; changes in quick succession share one message."""
        if not self._publishing:
            self._publishing = True
            self._world.after(0.001, lambda: self.node.do(self._publish))

    def _publish(self) -> None:
        self._publishing = False
        playing = self._playing
        if playing is not None and not playing.resting:
            flown_s = self._world.now_s - playing.record.began_s
            samples = int(flown_s / playing.assignment.plan.sample_time_s)
            self.decisions.progressed(playing.assignment, samples)
        if not self._robot.listeners or self._world.now_s < self._robot.states_lost_until_s:
            return
        state = self.decisions.state()
        until_s, late_s = self._robot.states_late
        extra_s = self._world.between(0.0, late_s) if self._world.now_s < until_s else 0.0
        for listener in self._robot.listeners:
            arrive = partial(listener.heard, self._robot.name, state)
            self._robot.network.send(self.node, listener.node, arrive, extra_s)
