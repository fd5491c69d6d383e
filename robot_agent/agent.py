"""The agent beside one robot: serves its keys, keeps it safe and plays its motions.

Queries are answered by one worker thread, motions are played by another, and Zenoh's threads only
hand events to them; a stop alone acts where it arrives. What may happen is decided by the pure
`supervisor` and `goal_machine`, under one lock.
"""

from __future__ import annotations

import hashlib
import logging
import queue
import threading
import time
import uuid
from collections import OrderedDict
from types import TracebackType

from robot_agent import goal_machine, supervisor
from robot_agent.excitation import plan_excitation, reference_of
from robot_agent.motion import HaltSwitch, play
from robot_agent.robot import Robot
from robot_agent.telemetry import TelemetryBatcher
from shared.codec import decode, encode
from shared.errors import MalformedMessageError, NufleetError, RefusedError, TransportError
from shared.excitation import ExcitationPlan
from shared.keys import FleetKeys
from shared.messages import (
    AcknowledgeRequest,
    CancelRequest,
    DescribeRequest,
    Description,
    Done,
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
    ReleaseRequest,
    ResultRequest,
    RobotState,
    RobotStatus,
    StopRequest,
)
from shared.transport import Request, Session

HEARTBEAT_S = 0.5
MAX_REQUEST_BYTES = 64 * 1024
MAX_WAITING_REQUESTS = 64
KEPT_RESULTS = 32
"""Results that nobody acknowledged are kept up to this number; the oldest go first."""

_log = logging.getLogger(__name__)
Reply = Description | GoalAccepted | GoalResult | Done | Refusal


class Agent:
    """Serves one robot on one session; a context manager that leaves the robot at rest."""

    def __init__(
        self, session: Session, keys: FleetKeys, name: str, robot: Robot, *, realtime: float | None
    ) -> None:
        self._session = session
        self._keys = keys
        self._name = name
        self._robot = robot
        self._realtime = realtime
        self._boot_id = uuid.uuid4().hex
        self._lock = threading.Lock()
        self._supervision = supervisor.Supervision()
        self._goals = goal_machine.Goals()
        self._plans: dict[str, ExcitationPlan] = {}
        self._results: OrderedDict[str, GoalResult] = OrderedDict()
        self._owners_alive: set[str] = set()
        self._switch = HaltSwitch()
        self._status = RobotStatus.IDLE
        self._reason = ""
        self._progress = 0.0
        self._last_goal: str | None = None
        self._robot_time_s = 0.0
        self._sequence = 0
        self._requests: queue.Queue[Request | None] = queue.Queue(MAX_WAITING_REQUESTS)
        self._motions: queue.Queue[tuple[goal_machine.Goal, ExcitationPlan] | None] = queue.Queue()
        self._closing = threading.Event()
        self._state_changed = threading.Event()
        self._threads = [
            threading.Thread(target=target, name=f"{name}-{what}", daemon=True)
            for what, target in (
                ("requests", self._answer_requests),
                ("motions", self._play_motions),
                ("heartbeat", self._publish_states),
            )
        ]

    def __enter__(self) -> Agent:
        self._robot.connect()
        key = self._keys.robot
        self._state = self._session.state_publisher(key(self._name, "state"))
        self._telemetry = self._session.telemetry_publisher(key(self._name, "telemetry/motion"))
        self._session.watch_alive(self._keys.every_orchestrator_alive, self._on_orchestrator)
        self._session.subscribe(key(self._name, "stop"), self._on_stop)
        self._session.subscribe(self._keys.stop, self._on_stop)
        self._session.serve(key(self._name, "**"), self._on_request)
        for thread in self._threads:
            thread.start()
        self._session.declare_alive(key(self._name, "alive"))  # last: from now on it can serve
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """End the motion in progress, leave the robot at rest, and stop serving."""
        if self._closing.is_set():
            return
        self._closing.set()
        self._switch.halt(Outcome.ABORTED, "the agent is shutting down")
        self._motions.put(None)
        self._requests.put(None)
        self._state_changed.set()
        for thread in self._threads:
            if thread.is_alive():
                thread.join()
        self._robot.disconnect()

    # Zenoh's threads: hand on and return.

    def _on_request(self, request: Request) -> None:
        try:
            self._requests.put_nowait(request)
        except queue.Full:
            request.answer(encode(Refusal(code="overloaded", reason="too many requests wait here")))

    def _on_orchestrator(self, key: str, alive: bool) -> None:
        owner = self._keys.orchestrator_of(key)
        with self._lock:
            if alive:
                self._owners_alive.add(owner)
                return
            self._owners_alive.discard(owner)
            self._supervise(supervisor.OwnerLost(owner))

    def _on_stop(self, key: str, payload: bytes) -> None:
        try:
            self._stop(decode(payload, StopRequest, max_bytes=MAX_REQUEST_BYTES))
        except MalformedMessageError as error:
            # Somebody wants this robot to stop; that the order is garbled does not make it move on.
            _log.warning("%s: malformed stop on %s: %s", self._name, key, error)
            self._stop(StopRequest(sender="unknown", reason=f"a malformed stop order: {error}"))

    def _stop(self, order: StopRequest) -> None:
        with self._lock:
            stop = supervisor.StopOrder(order.sender, order.reason)
            self._supervise(supervisor.StopOrdered(stop))
            if self._goals.running is None:
                self._set_status(RobotStatus.STOPPED, order.reason)
        self._state_changed.set()

    def _supervise(self, event: supervisor.Event) -> None:
        self._supervision, halt = supervisor.supervise(self._supervision, event)
        if halt is not None:
            self._switch.halt(halt.outcome, halt.reason)

    # The worker for queries.

    def _answer_requests(self) -> None:
        while (request := self._requests.get()) is not None:
            try:
                reply = self._reply_to(request)
            except RefusedError as error:
                reply = Refusal(code=error.code, reason=error.reason)
            except MalformedMessageError as error:
                reply = Refusal(code="malformed", reason=str(error)[:2000])
            except Exception as error:  # noqa: BLE001 - one bad request must not end the agent
                _log.exception("%s: answering %s", self._name, request.key)
                reply = Refusal(code="internal-error", reason=repr(error)[:2000])
            try:
                request.answer(encode(reply))
            except NufleetError as error:
                _log.warning("%s: the reply on %s was lost: %s", self._name, request.key, error)

    def _reply_to(self, request: Request) -> Reply:
        leaf = request.key.removeprefix(self._keys.robot(self._name, ""))
        payload = request.payload
        cap = MAX_REQUEST_BYTES
        match leaf:
            case "describe":
                decode(payload, DescribeRequest, max_bytes=cap)
                return Description(robot=self._name, boot_id=self._boot_id, spec=self._robot.spec)
            case "goal":
                return self._take_goal(decode(payload, GoalRequest, max_bytes=cap))
            case "cancel":
                return self._cancel(decode(payload, CancelRequest, max_bytes=cap))
            case "result":
                return self._result(decode(payload, ResultRequest, max_bytes=cap).goal_id)
            case "acknowledge":
                self._forget(decode(payload, AcknowledgeRequest, max_bytes=cap).goal_ids)
                return Done()
            case "stop":
                self._stop(decode(payload, StopRequest, max_bytes=cap))
                return Done()
            case "release":
                return self._release(decode(payload, ReleaseRequest, max_bytes=cap))
            case _:
                return Refusal(
                    code="unknown-key", reason=f"this robot does not serve {leaf!r}"[:2000]
                )

    def _take_goal(self, request: GoalRequest) -> GoalAccepted | Refusal:
        digest = hashlib.sha256(request.excitation.model_dump_json().encode()).hexdigest()
        goal_id, owner = request.goal_id, request.owner
        self._forget(request.acknowledges)
        owner_alive = self._is_alive(owner)
        with self._lock:
            answer = goal_machine.recognise(self._goals, goal_id=goal_id, digest=digest)
            if answer is None:
                refusal = supervisor.refusal_to_start(
                    self._supervision, owner=owner, owner_alive=owner_alive
                )
                if refusal is not None:
                    return refusal
                plan = plan_excitation(request.excitation, self._robot.spec, robot=self._name)
                self._goals, answer = goal_machine.submit(
                    self._goals, goal_id=goal_id, owner=owner, digest=digest
                )
                if isinstance(answer, goal_machine.Accepted):
                    self._begin(answer.goal, plan)
            if isinstance(answer, Refusal):
                return answer
            plan = self._plans[goal_id]
        return GoalAccepted(
            goal_id=goal_id,
            boot_id=self._boot_id,
            plan=plan,
            wall_duration_s=0.0 if self._realtime is None else plan.duration_s / self._realtime,
        )

    def _begin(self, goal: goal_machine.Goal, plan: ExcitationPlan) -> None:
        self._plans[goal.goal_id] = plan
        for forgotten in [known for known in self._plans if known not in self._goals.known]:
            del self._plans[forgotten]
        self._supervise(supervisor.MotionBegan(goal.owner))
        self._switch = HaltSwitch()
        if self._closing.is_set():
            self._switch.halt(Outcome.ABORTED, "the agent is shutting down")
        self._progress = 0.0
        self._set_status(RobotStatus.RUNNING, "")
        self._motions.put((goal, plan))

    def _is_alive(self, owner: str) -> bool:
        with self._lock:
            if owner in self._owners_alive:
                return True
        # The token may be on its way: ask, once, before saying no.
        return bool(self._session.alive(self._keys.orchestrator_alive(owner), timeout_s=1.0))

    def _cancel(self, request: CancelRequest) -> Done | Refusal:
        with self._lock:
            refusal = goal_machine.cancel(self._goals, request.goal_id)
            if refusal is not None:
                return refusal
            self._switch.halt(Outcome.CANCELLED, "cancelled")
        return Done()

    def _result(self, goal_id: str) -> GoalResult | Refusal:
        with self._lock:
            if goal_id in self._results:
                return self._results[goal_id]
            goal = self._goals.known.get(goal_id)
        if goal is None:
            return Refusal(code="unknown-goal", reason=f"goal {goal_id} is not known here")
        if goal.outcome is None:
            return Refusal(code="not-finished", reason=f"goal {goal_id} is still running")
        return Refusal(code="result-gone", reason=f"the result of {goal_id} was let go already")

    def _forget(self, goal_ids: tuple[str, ...]) -> None:
        with self._lock:
            for goal_id in goal_ids:
                self._results.pop(goal_id, None)

    def _release(self, request: ReleaseRequest) -> Done | Refusal:
        with self._lock:
            if self._goals.running is not None:
                return Refusal(code="busy", reason="still coming to rest; release it in a moment")
            self._supervise(supervisor.ReleaseOrdered(request.sender))
            self._set_status(RobotStatus.IDLE, "")
        return Done()

    # The worker for motions.

    def _play_motions(self) -> None:
        while (motion := self._motions.get()) is not None:
            goal, plan = motion
            telemetry = TelemetryBatcher(
                self._telemetry, goal.goal_id, plan.sample_time_s, clock=time.monotonic
            )
            reference = reference_of(plan)

            def on_samples(first, batch, response, telemetry=telemetry, plan=plan):  # type: ignore[no-untyped-def]
                telemetry.add(first, batch, response)
                self._progress = min(1.0, (first + len(batch)) / plan.samples)

            played = play(
                self._robot,
                plan.axis,
                reference,
                realtime=self._realtime,
                switch=self._switch,
                on_samples=on_samples,
            )
            telemetry.flush()
            self._end(
                GoalResult(
                    goal_id=goal.goal_id,
                    boot_id=self._boot_id,
                    outcome=played.outcome,
                    reason=played.reason[:2000],
                    plan=plan,
                    reference=played.reference,
                    response=played.response,
                )
            )

    def _end(self, result: GoalResult) -> None:
        with self._lock:
            self._results[result.goal_id] = result
            while len(self._results) > KEPT_RESULTS:
                self._results.popitem(last=False)
            self._goals = goal_machine.end(self._goals, result.goal_id, result.outcome)
            self._supervise(supervisor.MotionEnded())
            self._last_goal = result.goal_id
            self._robot_time_s += len(result.reference) * result.plan.sample_time_s
            stop = self._supervision.stop
            if stop is None:
                self._set_status(RobotStatus.IDLE, result.reason)
            else:
                self._set_status(RobotStatus.STOPPED, stop.reason)

    # The heartbeat.

    def _set_status(self, status: RobotStatus, reason: str) -> None:
        self._status, self._reason = status, reason
        self._state_changed.set()

    def _publish_states(self) -> None:
        while True:
            self._state_changed.clear()
            try:
                self._state.put(encode(self._current_state()))
            except TransportError as error:
                _log.warning("%s: heartbeat not sent: %s", self._name, error)
            if self._closing.is_set():
                return
            self._state_changed.wait(HEARTBEAT_S)

    def _current_state(self) -> RobotState:
        with self._lock:
            self._sequence += 1
            return RobotState(
                robot=self._name,
                boot_id=self._boot_id,
                sequence=self._sequence,
                status=self._status,
                goal_id=self._goals.running,
                progress=self._progress,
                reason=self._reason[:2000],
                last_goal_id=self._last_goal,
                robot_time_s=self._robot_time_s,
            )
