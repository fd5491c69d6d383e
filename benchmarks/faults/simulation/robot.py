"""A robot and the agent process beside it: the product's decisions in a simulated process."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Executor, Future
from functools import partial
from typing import Any

import numpy as np

from benchmarks.faults.simulation.disk import Disk, DiskJournal
from benchmarks.faults.simulation.driver import MotionThread, SimulatedDriver
from benchmarks.faults.simulation.history import History, Motion, Violation
from benchmarks.faults.simulation.network import Network, Node, OnAnswer
from benchmarks.faults.simulation.turn import Turn
from benchmarks.faults.simulation.world import World
from nufleet.robot_agent.commands import Commands
from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.motion.excitation import peak_velocity_and_acceleration, reference_of
from nufleet.robot_agent.motion.pace import GAP_MAX_S
from nufleet.robot_agent.motion.perform import Played
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.network.heartbeat import HEARTBEAT_S
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules import fitness
from nufleet.robot_agent.rules.freezes import Freezes
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.robot_agent.stop_service import StopService
from nufleet.shared.errors import MalformedMessageError, RefusedError
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.keys import FleetKeys
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
_READY, _LOCKED = Health(), Health(ready=False, reason="locked")
_KEYS, _COMMANDS = FleetKeys("sim"), Commands(None)
_PLANS: dict[tuple[float, AskedMotion], MotionPlan] = {}
_NO_SAMPLES = np.empty(0)


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


class _Changed:
    """Substitute for the event that `Decisions` sets when its state is to be published."""

    def __init__(self, agent: SimulatedAgent) -> None:
        self._agent = agent

    def set(self) -> None:
        self._agent.change()


class _AtOnce(Executor):
    """Does what it is given at once, as a disk does that takes no time."""

    def submit(self, work: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        done: Future[Any] = Future()
        done.set_result(work(*args, **options))
        return done


class _Stops(StopService):
    """The product's handling of stops; a driver's `kill` takes its time on the virtual clock."""

    def __init__(self, agent: SimulatedAgent, kill: Callable[[], None]) -> None:
        decisions = agent.decisions
        super().__init__(agent.name, decisions, _KEYS, _COMMANDS, kill, writer=_AtOnce())
        self._agent = agent

    def _start(self, work: Callable[[], None]) -> None:
        self._agent.cut_motors(work)


class SimulatedRobot:
    """One robot: its spec, its disk, and the agent that serves it now, if any."""

    def __init__(
        self,
        world: World,
        network: Network,
        history: History,
        name: str,
        spec: RobotSpec,
        reports: bool,
    ) -> None:
        self.world, self.network, self.history = world, network, history
        self.name, self.spec, self.reports = name, spec, reports
        self.disk = Disk()
        self.bad_sensor = 0
        self.states_lost_until_s = 0.0
        self.states_late: tuple[float, float] = (0.0, 0.0)
        self.unready_until_s = 0.0
        self.unreported_until_s = 0.0
        self.outdated_until_s = 0.0
        self.lives = 0
        self.agent: SimulatedAgent | None = None
        self.listeners: list[Any] = []
        self.start()

    @property
    def in_the_air(self) -> bool:
        """Whether the robot has taken off and its agent has not landed it yet."""
        return self.agent is not None and self.agent.motions.in_the_air

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

    def outdate(self, for_s: float) -> None:
        """Replace the agent for a while by one of another protocol version."""
        self.outdated_until_s = self.world.now_s + for_s
        self.history.excuses.add((self.name, "malformed"))
        self.kill(0.2)
        self.world.after(for_s, lambda: self.kill(0.2))


class SimulatedAgent:
    """One agent process."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self.world, self.history, self.name = robot.world, robot.history, robot.name
        self._robot = robot
        self.boot_id = f"{robot.name}-boot-{robot.lives}"
        self._outdated = self.world.now_s < robot.outdated_until_s
        self._publishing = False
        self._turn = Turn(robot.name)
        self._freezes = Freezes(self.world.now_s)
        journal: Any = DiskJournal(robot.disk)
        changed: Any = _Changed(self)
        planner = CachedPlanner(robot.name, robot.spec, (), Memory(None), 1.0)
        self.decisions = Decisions(
            self.boot_id, planner, journal, changed, lambda: self.world.now_s
        )
        self._driver = SimulatedDriver(robot.name, robot.spec, robot.history, robot.world)
        self._watched = WatchedRobot(self._driver, realtime=1.0)
        self.history.killed.pop(self.name, None)  # a person started another agent
        self._watched.connect()
        self.motions = MotionThread(self, self._watched, self._driver)
        self._stops = _Stops(self, self._kill)
        # The product waits for the first answer before it serves the robot.
        self._health = (_READY, self.world.now_s)
        self.node: Node = robot.network.join("robot", robot.name, self)
        self._beat()

    def die(self) -> None:
        """End the process at once; without references its robot comes to rest."""
        self._robot.network.end(self.node)
        self.motions.die()

    # Events from the network.

    def told(self, kind: str, name: str, alive: bool) -> None:
        if kind == "orchestrator":
            if not alive:
                self._turn.lost(name)
            (self.decisions.owner_appeared if alive else self.decisions.owner_lost)(name)
            self.motions.look()

    def asked(self, question: str, body: Any, answer: OnAnswer) -> None:
        try:
            said = self._answer(question, body)
        except RefusedError as error:
            said = Refusal(code=error.code, reason=error.reason)
        except JournalError as error:
            said = Refusal(code="journal", reason=str(error))
        except MalformedMessageError as error:
            said = Refusal(code="malformed", reason=str(error))
        if isinstance(said, Future):
            said.add_done_callback(lambda done: answer(done.result()))
        else:
            answer(Done() if said is None else said)
        self.motions.look()

    def _answer(self, question: str, body: Any) -> Any:
        decisions = self.decisions
        if question == "stop":
            sender, payload = body
            self.history.stop_arrived(self.world.now_s, self.name, sender)
            return self._stops.asked(sender, b"of another version" if self._outdated else payload)
        if self._outdated:
            return Refusal(code="malformed", reason="the message speaks another protocol version")
        match question:
            case "goal":
                return self._take(body)
            case "result":
                return decisions.result(body)
            case "cancel":
                goal_id, sender = body
                refusal = decisions.cancel(goal_id, sender)
                if refusal is None:
                    self.history.cancelled.add((self.name, goal_id))
                return refusal
            case "acknowledge":
                goal_ids, sender = body
                return decisions.acknowledge(goal_ids, sender)
            case "release":
                return self._release(body)
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
        refusal = self._freezes.refusal(self.world.now_s)
        if refusal is not None and not self.decisions.knows(request.goal_id):
            return refusal
        accepted, motion = self.decisions.take(request)
        if motion is not None:
            self._turn.accepted(request, self.world.now_s)
            self.history.accepted[self.name, request.goal_id] = self.world.now_s
            self.motions.begin(motion)
        elif isinstance(accepted, Refusal) and accepted.code == "busy":
            self._turn.refused(request, self.world.now_s)
        return accepted

    def frozen(self) -> str | None:
        """Return that the process was frozen; None if that is long ago."""
        refusal = self._freezes.refusal(self.world.now_s)
        return None if refusal is None else refusal.reason

    def _release(self, sender: str) -> Any:
        refusal = self.decisions.release(sender)
        if refusal is not None:
            return refusal
        self.history.release_taken(self.world.now_s, self.name)
        if self.decisions.fault is None:
            self.history.release_confirmed(self.world.now_s, self.name)
            return None
        answer: Future[Any] = Future()

        def reconnected(said: Any) -> None:
            if isinstance(said, Done):
                self.history.release_confirmed(self.world.now_s, self.name)
            answer.set_result(said)

        self.motions.reconnect(reconnected)
        return answer

    # The driver's switch.

    def _kill(self) -> None:
        self._watched.kill()
        self.history.motors_cut(self.world.now_s, self.name)

    def cut_motors(self, work: Callable[[], None]) -> None:
        """Have the driver cut the motors on a thread of its own, which takes a moment."""
        after, between, do = self.world.after, self.world.between, self.node.do
        self.history.excuses.add((self.name, "fault"))
        cut_s = between(0.0, 0.2)
        after(cut_s, lambda: do(self._driver.kill))
        after(cut_s + between(0.0, 0.05), lambda: do(work))

    # The ends of motions.

    def ended(self, assignment: Assignment, played: Played, record: Motion | None) -> None:
        """Report the end of a motion; its entry in the history is None if it did not begin."""
        bad = played.outcome is Outcome.COMPLETED and self._robot.bad_sensor > 0
        self._robot.bad_sensor -= bad
        if record is not None:
            record.completed = played.outcome is Outcome.COMPLETED and not bad
        goal_id, samples = assignment.goal.goal_id, len(played.samples.reference)
        self.history.tell(self.world.now_s, f"{self.name} ended {goal_id}: {played.outcome}")
        reason = BAD_SENSOR if bad else played.reason
        result = _result(goal_id, self.boot_id, played.outcome, reason, assignment.plan, samples)
        self.decisions.ended(result, played.fault)

    def landed(self, failed: str | None) -> None:
        """Report that the robot was ended after it had been idle, or why that failed."""
        self.history.tell(self.world.now_s, f"{self.name} is ended: {failed or 'well'}")
        if failed is not None:
            self.decisions.broke(failed)

    # Heartbeats.

    def _beat(self) -> None:
        self.note_gap()
        self.node.frozen_since_s = 0.0
        self._freezes.beat(self.world.now_s)
        self._publish()
        self.world.after(HEARTBEAT_S, lambda: self.node.do(self._beat))

    def note_gap(self) -> None:
        """End a motion whose samples are too far apart, as `Pace` does."""
        gap_s, playing = self.world.now_s - self.node.frozen_since_s, self.motions.playing
        if self.node.frozen_since_s and gap_s > GAP_MAX_S and playing is not None:
            playing.assignment.switch.halt(Outcome.ABORTED, f"nothing for {gap_s:.1f} s")
            self.motions.look()

    def _look_at_health(self) -> None:
        """Ask the driver for the robot's health, unless it hangs, and judge it as it is."""
        robot, now_s = self._robot, self.world.now_s
        if now_s >= robot.unreported_until_s:
            self._health = (_LOCKED if now_s < robot.unready_until_s else _READY, now_s)
        health, reported_s = self._health
        age_s = now_s - reported_s
        ready = age_s <= fitness.HEALTH_MAX_AGE_S and health.ready
        self.decisions.reported(health, fitness.unfit(health, age_s))
        self.history.report(now_s, self.name, ready=ready)
        playing = self.motions.playing
        if not ready and playing is not None and playing.assignment.switch.order is None:
            raise Violation(f"{now_s:.3f}: {self.name} is not ready, and its motion continues")
        self.motions.look()

    def change(self) -> None:
        """Publish the state soon; changes in quick succession share one message."""
        if not self._publishing:
            self._publishing = True
            self.world.after(0.001, lambda: self.node.do(self._publish))

    def _publish(self) -> None:
        self._publishing = False
        robot, now_s, playing = self._robot, self.world.now_s, self.motions.playing
        if robot.reports:
            self._look_at_health()
        if playing is not None and playing.moves and playing.record is not None:
            samples = int((now_s - playing.record.began_s) / robot.spec.sample_time_s)
            self.decisions.progressed(playing.assignment, samples)
        if not robot.listeners or now_s < robot.states_lost_until_s or self._outdated:
            return
        state = self.decisions.state()
        until_s, late_s = robot.states_late
        extra_s = self.world.between(0.0, late_s) if now_s < until_s else 0.0
        for listener in robot.listeners:
            arrive = partial(listener.heard, robot.name, state)
            robot.network.send(self.node, listener.node, arrive, extra_s)
