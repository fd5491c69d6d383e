"""The agent beside one robot: joins the robot to its fleet and keeps it safe.

Zenoh's threads hand requests to the endpoint's worker, which asks `Decisions`. The motion worker
alone moves the robot, and the heartbeat publishes its state. A stop takes effect on the thread on
which it arrives.
"""

from __future__ import annotations

import logging
import time
import uuid
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, nullcontext
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from nufleet.robot_agent.commands import Commands
from nufleet.robot_agent.decisions import Decisions
from nufleet.robot_agent.experience_service import ExperienceService
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.forecast_service import ForecastService
from nufleet.robot_agent.journal.audit_log import AuditLog
from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.journal.unrecorded import Unrecorded
from nufleet.robot_agent.motion.health_watch import HealthWatch
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.motion_worker import MotionWorker
from nufleet.robot_agent.network.certificate_watch import CertificateWatch
from nufleet.robot_agent.network.endpoint import (
    MAX_LARGE_REQUEST_BYTES,
    MAX_REQUEST_BYTES,
    Answer,
    Endpoint,
    Handler,
)
from nufleet.robot_agent.network.rivals import Rivals
from nufleet.robot_agent.network.squad import Squad
from nufleet.robot_agent.network.trust import Trust
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.robot import Robot
from nufleet.robot_agent.rules import fitness
from nufleet.robot_agent.rules.freezes import Freezes
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.robot_agent.stop_service import StopService
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire import messages
from nufleet.shared.wire.codec import M, decode
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.limits import MAX_STATE_BYTES
from nufleet.shared.wire.motions import MotionPlan
from nufleet.shared.wire.session import Session

OWNER_PATIENCE_S = 1.0
"""Time that a goal waits for its owner's liveliness token, which may arrive after the goal."""

_log = logging.getLogger(__name__)


class Agent:
    """Serves one robot on one session; a context manager that leaves the robot at rest."""

    def __init__(
        self,
        session: Session,
        keys: FleetKeys,
        name: str,
        robot: Robot,
        *,
        realtime: float | None,
        state_folder: Path | None = None,
        policy: RobotPolicy | None = None,
        squad: Squad | None = None,
        prompt: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        """Prepare the agent; nothing is connected before the context is entered.

        Args:
            session: Session of this robot; a real one's serves it alone, so that losing the session
                affects no other robot.
            keys: Keys of the robot's fleet.
            name: Name of the robot.
            robot: The robot's driver, disconnected.
            realtime: Multiple of real time at which a simulated robot plays; None for as fast as it
                can.
            state_folder: Folder for the state that has to survive this agent (journal and learned
                models); None to keep nothing.
            policy: What the robot's fleet file lets others have it do; None for what a file says
                that does not mention it.
            squad: Robots that share the session; None for a robot alone.
            prompt: Context in which the robot moves, on the thread that moves it.

        Raises:
            MemoryFolderError: A learned model in the state folder is damaged.
        """
        self._session = session
        self._keys = keys
        self._name = name
        self._robot = WatchedRobot(robot, realtime=realtime)
        self._realtime = realtime
        self._state_folder = state_folder
        self._policy = policy or RobotPolicy()
        self._given_squad = squad
        self._prompt = prompt
        self._boot_id = uuid.uuid4().hex
        self._rivals = Rivals(name, self._boot_id, time.monotonic)
        self._freezes = Freezes(time.monotonic())
        self._memory = Memory(None if state_folder is None else state_folder / "learned")
        self._looks: list[Callable[[], None]] = []
        self._open = ExitStack()

    def __enter__(self) -> Agent:
        """Connect the robot and serve it; nothing stays open if this raises.

        Raises:
            JournalInUseError: Another agent serves this robot from the same state folder.
            JournalError: The robot's journal cannot be read or written.
            RobotError: The robot cannot be connected.
        """
        with ExitStack() as opened:
            self._squad = self._given_squad or opened.enter_context(
                Squad(self._session, self._keys)
            )
            # The journal comes first: its lock reveals a second agent before both reach for the
            # robot.
            self._remember(opened)
            opened.callback(self._robot.let_go)
            self._robot.connect()
            self._watch_health(opened)
            self._join(opened)
            self._open = opened.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    @property
    def name(self) -> str:
        """Name of the robot that this agent serves."""
        return self._name

    def halt(self) -> None:
        """End the motion in progress and accept no other; returns at once."""
        self._decisions.shut_down()

    def close(self) -> None:
        """End the motion in progress, leave the robot at rest, and stop serving.

        A second call does nothing.

        Raises:
            RobotError: The robot cannot be left at rest.
        """
        self._open.close()

    def _remember(self, opened: ExitStack) -> None:
        folder = self._state_folder
        journal = Unrecorded() if folder is None else Journal(folder / "journal")
        opened.callback(journal.close)
        for goal_id in journal.remembrance.lost:
            _log.warning("%s: goal %s was lost with the previous agent", self._name, goal_id)
        robot, memory = self._robot, self._memory
        planner = Planner(
            self._name,
            robot.spec,
            robot.state_names,
            memory,
            self._realtime,
            self._policy.allow_unguarded,
        )
        changed = self._squad.heartbeat.change(self._name)
        self._decisions = Decisions(
            self._boot_id, planner, journal, changed, may_last=self._may_last(planner)
        )
        change = self._decisions.change
        audit = None if folder is None else AuditLog(folder, self._squad.clerks)
        if audit is not None:
            opened.callback(audit.close)
        self._commands = Commands(audit)
        session, most = self._session, self._policy.prior_output_max
        trust = Trust(self._name, self._policy, session.identity, session.admitted_robots)
        self._experiences = ExperienceService(self._name, robot, memory, change, trust, most)
        self._forecasts = ForecastService(planner, lambda: self._decisions.running)
        opened.callback(self._forecasts.close)

    def _may_last(self, planner: Planner) -> Callable[[MotionPlan], messages.Refusal | None]:
        """Return the function that refuses motions which outlast the battery or certificate."""
        identity = self._session.identity
        watch = None if identity is None else CertificateWatch(identity, partial(datetime.now, UTC))
        if watch is not None:
            self._looks.append(watch.look)

        def refusal(plan: MotionPlan) -> messages.Refusal | None:
            health, _ = self._health.newest
            too_long = fitness.refusal_to_last(health, plan.duration_s)
            if too_long is None and watch is not None:
                too_long = watch.refusal(planner.wall_duration_s(plan))
            return too_long

        return refusal

    def _watch_health(self, opened: ExitStack) -> None:
        self._health = HealthWatch(self._name, self._robot, fitness.HEALTH_INTERVAL_S)
        opened.callback(self._health.close)
        self._report_health()
        self._looks.append(self._report_health)

    def _report_health(self) -> None:
        self._decisions.reported(self._health.newest[0], self._unfit())

    def _unfit(self) -> str | None:
        return fitness.unfit(*self._health.newest)

    def _join(self, opened: ExitStack) -> None:
        """Open all services in the order of their dependencies; they close in reverse order."""
        session, keys, name, decisions = self._session, self._keys, self._name, self._decisions
        experiences, command = self._experiences, self._commands.handler
        heard = self._rivals.heard
        state_key = keys.robot(name, "state")
        rivals = session.subscribe(state_key, heard, max_bytes=MAX_STATE_BYTES, own=False)
        opened.callback(rivals.withdraw)
        opened.callback(self._squad.heartbeat.join(name, self._state, heard))
        kill, writer = self._robot.kill, self._squad.writer
        stops = StopService(name, decisions, keys, self._commands, kill, writer=writer)
        opened.callback(stops.close)
        stop_key = keys.robot(name, "**/stop")
        own_stops = session.subscribe(stop_key, stops.heard, max_bytes=MAX_REQUEST_BYTES)
        opened.callback(own_stops.withdraw)
        opened.callback(self._squad.hear_stops(name, stops.halted))
        everyone = keys.every_orchestrator_alive
        opened.callback(session.watch_alive(everyone, self._on_orchestrator).withdraw)
        samples = session.telemetry_publisher(keys.robot(name, "telemetry/motion"))
        path_samples = session.telemetry_publisher(keys.robot(name, "telemetry/tracking"))
        self._motions = MotionWorker(
            name,
            self._boot_id,
            self._robot,
            self._memory,
            decisions,
            samples,
            path_samples,
            self._squad.clerks,
            realtime=self._realtime,
            prompt=self._prompt,
            foretold=self._forecasts.foretold,
            hindrance=self._frozen,
            unfit=self._unfit,
        )
        opened.callback(self._motions.close)
        self._looks += [self._motions.look_after_robot, self._forecasts.look]
        endpoint = Endpoint(
            session,
            keys,
            name,
            handlers={
                "describe": self._describe,
                "result": _decoding(messages.ResultRequest, lambda r: decisions.result(r.goal_id)),
                "experience": _decoding(messages.FetchRequest, experiences.fetch),
                "prior": _decoding(messages.FetchRequest, experiences.fetch),
                "forecast": self._forecasts.asked,
            },
            commands={
                "goal": command(messages.GoalRequest, self._take_goal),
                "cancel": command(messages.CancelRequest, self._cancel),
                "acknowledge": command(messages.AcknowledgeRequest, self._acknowledge),
                "release": command(messages.ReleaseRequest, self._release),
                "experience/install": command(
                    messages.InstallRequest, experiences.install_experience
                ),
                "prior/install": command(messages.InstallRequest, experiences.install_prior),
                "prior/remove": command(messages.RemovePriorRequest, experiences.remove_prior),
            },
            large=("goal", "forecast", "experience/install", "prior/install"),
            urgent={"stop": stops.asked},
        )
        opened.callback(endpoint.close)
        opened.callback(decisions.shut_down)
        # The liveliness token comes last, since it announces that the agent can serve.
        opened.callback(session.declare_alive(keys.robot(name, "alive")).withdraw)

    def _state(self) -> messages.RobotState:
        """Return the state that the heartbeat publishes.

        Since this is called regularly, it also records that the process runs and checks the driver.
        """
        self._freezes.beat(time.monotonic())
        for look in self._looks:
            look()
        return self._decisions.state()

    # Called on Zenoh's threads: pass the event on and return.

    def _on_orchestrator(self, key: str, alive: bool) -> None:
        owner = self._keys.orchestrator_of(key)
        if owner is None:
            _log.warning("%s: ignoring %r, which is not an orchestrator's key", self._name, key)
        elif alive:
            self._decisions.owner_appeared(owner)
        else:
            self._decisions.owner_lost(owner)

    # Called on the endpoint's worker.

    def _describe(self, payload: bytes) -> Answer:
        _decoded(payload, messages.DescribeRequest)
        commander = self._decisions.commander
        return messages.Description(
            robot=self._name,
            boot_id=self._boot_id,
            spec=self._robot.spec,
            state_names=self._robot.state_names,
            experiences=self._experiences.offers(),
            prior=next(iter(self._experiences.priors()), None),
            companions=self._experiences.priors()[1:],
            own_flight_s=dict(self._memory.flown_s),
            owner=None if commander is None else commander.owner,
            epoch=0 if commander is None else commander.epoch,
        )

    def _take_goal(self, request: messages.GoalRequest) -> Answer:
        refusal = self._rivals.refusal()
        if refusal is None and not self._decisions.knows(request.goal_id):
            refusal = self._freezes.refusal(time.monotonic())
        if refusal is not None:
            return refusal
        self._await_owner(request.owner)
        answer, motion = self._decisions.take(request)
        if motion is not None:
            self._forecasts.end()
            self._motions.begin(motion)
        return answer

    def _frozen(self) -> str | None:
        refusal = self._freezes.refusal(time.monotonic())
        return None if refusal is None else refusal.reason

    def _await_owner(self, owner: str) -> None:
        """Wait for the token of an owner whose goal arrived first, if the network knows the token.

        Knowing that the token exists is not enough to begin a motion: the subscription that has not
        reported the token's appearance would not report its disappearance either.
        """
        if self._decisions.wait_for_owner(owner, timeout_s=0.0):
            return
        if self._session.alive(self._keys.orchestrator_alive(owner), timeout_s=OWNER_PATIENCE_S):
            self._decisions.wait_for_owner(owner, timeout_s=OWNER_PATIENCE_S)

    def _cancel(self, request: messages.CancelRequest) -> Answer:
        sender = Commander(request.sender, request.epoch)
        return self._decisions.cancel(request.goal_id, sender) or messages.Done()

    def _acknowledge(self, request: messages.AcknowledgeRequest) -> Answer:
        sender = Commander(request.sender, request.epoch)
        return self._decisions.acknowledge(request.goal_ids, sender) or messages.Done()

    def _release(self, request: messages.ReleaseRequest) -> Answer:
        refusal = self._decisions.release(request.sender)
        if refusal is not None:
            return refusal
        return messages.Done() if self._decisions.fault is None else self._motions.reconnect()


def _decoded(payload: bytes, expected: type[M]) -> M:
    return decode(payload, expected, max_bytes=MAX_LARGE_REQUEST_BYTES)


def _decoding(expected: type[M], answer: Callable[[M], Answer]) -> Handler:
    """Return a handler that decodes a request and answers it."""
    return lambda payload: answer(_decoded(payload, expected))
