"""An orchestrator's client of a fleet: the robots' presence and states, and requests to them."""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Literal, TypeVar

from nufleet.orchestrator.fleet.heard_states import state_heard, states_heard
from nufleet.orchestrator.fleet.requests import QUERY_TIMEOUT_S, RESULT_TIMEOUT_S, Reply, Requests
from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import (
    InvalidInputError,
    MalformedMessageError,
    NoReplyError,
    RobotLostError,
)
from nufleet.shared.robots.health import Health
from nufleet.shared.wire.codec import Message, decode, encode
from nufleet.shared.wire.frame import new_order_id
from nufleet.shared.wire.keys import RELEASE, STOP, FleetKeys, principal_of
from nufleet.shared.wire.limits import MAX_STATES_BYTES
from nufleet.shared.wire.messages import (
    AcknowledgeRequest,
    CancelRequest,
    DescribeRequest,
    Description,
    Done,
    ExperienceFile,
    ExperienceOffer,
    FetchRequest,
    ForecastRequest,
    Foreseen,
    ForeseenWay,
    GoalAccepted,
    GoalRequest,
    GoalResult,
    InstallRequest,
    PathForecast,
    ReleaseRequest,
    RemovePriorRequest,
    ResultRequest,
    RobotState,
    StopRequest,
    Telemetry,
    TrackingTelemetry,
)
from nufleet.shared.wire.session import Session

RELEASE_TIMEOUT_S = 65.0
"""A robot with a fault is reconnected before it confirms its release, which may take a minute."""
FORECAST_TIMEOUT_S = 20.0
"""A robot that has learned something since may first have to work out what it knows of itself."""
FORECAST_LOOK_S = 0.3
"""Interval between two requests for the same forecast, well within a robot's patience."""
DESCRIBE_TRIES = 3
"""How often a robot that is there is asked to describe itself, before it counts as not answering:
of many robots on a busy machine, one may be late."""
TELEMETRY_MAX_BYTES = 4 * 2**20
"""Largest batch: the samples that an unpaced simulated robot plays in a tenth of a second."""

_A = {"robot": "a robot", "operator": "an operator", "watcher": "a watcher"}

_log = logging.getLogger(__name__)
R = TypeVar("R", bound=Message)


class Fleet:
    """A client of all robots of one fleet, alive under its own id for as long as its session is.

    Observers are called on network threads, in order per robot; they must return at once. Requests
    that command a robot carry the epoch of the lease under which it is commanded; see `hold`.

    Every request to a robot raises NoReplyError when the robot does not answer, RobotLostError when
    several agents answer under its name, RefusedError when it refuses, and MalformedMessageError
    when its reply cannot be decoded.
    """

    def __init__(self, session: Session, keys: FleetKeys, orchestrator_id: str) -> None:
        self.orchestrator_id = orchestrator_id
        self._session = session
        self._keys = keys
        self._requests = Requests(session, keys, orchestrator_id)
        self._epochs: Mapping[str, int] = {}
        self._lock = threading.Lock()
        self._watches: dict[str, RobotWatch] = {}
        self._state_observers: list[Callable[[RobotState], None]] = []
        self._telemetry_observers: list[Callable[[str, Telemetry], None]] = []
        self._tracking_observers: list[Callable[[str, TrackingTelemetry], None]] = []
        session.declare_alive(keys.orchestrator_alive(orchestrator_id))
        session.watch_alive(keys.every_robot("alive"), self._on_presence)
        session.subscribe_state(keys.every_robot("state"), self._on_state)
        if session.identity is None:
            session.subscribe(keys.states, self._on_states, max_bytes=MAX_STATES_BYTES)

    def hold(self, epochs: Mapping[str, int]) -> None:
        """Set the epochs of the leases under which robots are commanded from now on.

        Args:
            epochs: Epoch of the lease, by robot; all other robots are commanded without a lease.
        """
        self._epochs = dict(epochs)

    def epoch(self, robot: str) -> int:
        """Return the epoch of the lease under which a robot is commanded; 0 without one."""
        return self._epochs.get(robot, 0)

    def check_may_command(self) -> None:
        """Refuse before anything begins what the router of a closed fleet would keep from robots.

        Raises:
            InvalidInputError: The identity is not an orchestrator's.
        """
        identity = self._session.identity
        if identity is not None and identity.role != "orchestrator":
            raise InvalidInputError(
                f"{identity.principal} may not ask robots of fleet {identity.fleet} to move, nor "
                f"change what they fly with, because it is {_A[identity.role]} in the inventory: "
                "choose the identity of an orchestrator with --identity"
            )

    # Presence and states.

    def watch(self, robot: str) -> RobotWatch:
        """Return the watch on a robot, which always holds its latest known state."""
        with self._lock:
            return self._watches.setdefault(robot, RobotWatch(robot))

    def health(self, robot: str) -> Health | None:
        """Return a robot's latest health; None for a robot that reports none, or no state yet."""
        watch = self.watch(robot)
        watch.wait_until(lambda known: known.state is not None, timeout_s=QUERY_TIMEOUT_S)
        return None if watch.state is None else watch.state.health

    def robots(self) -> tuple[str, ...]:
        """Return the names of the robots whose agents are alive now."""
        with self._lock:
            watches = list(self._watches.values())
        return tuple(sorted(watch.robot for watch in watches if watch.alive))

    def wait_for(self, robots: tuple[str, ...], *, timeout_s: float) -> None:
        """Wait until all these robots are alive.

        Args:
            robots: Names of the robots to wait for.
            timeout_s: Longest time to wait, in s.

        Raises:
            RobotLostError: Some robots did not appear in time; the message names them.
        """
        deadline = time.monotonic() + timeout_s
        for robot in robots:
            left_s = max(0.0, deadline - time.monotonic())
            if not self.watch(robot).wait_until(lambda w: w.alive, timeout_s=left_s):
                there = ", ".join(self.robots()) or "none"
                raise RobotLostError(
                    f"robot {robot} did not appear within {timeout_s:g} s; robots present: {there}"
                )

    def is_alive(self, orchestrator_id: str) -> bool:
        """Return whether the orchestrator with this id is alive; raises TransportError."""
        key = self._keys.orchestrator_alive(orchestrator_id)
        return bool(self._session.alive(key, timeout_s=QUERY_TIMEOUT_S))

    def observe_states(self, observer: Callable[[RobotState], None]) -> None:
        """Call an observer with every state, unless a later one of its robot came before it."""
        self._state_observers.append(observer)

    def observe_telemetry(self, observer: Callable[[str, Telemetry], None]) -> None:
        """Call an observer with the robot's name and every batch of samples that arrives."""
        self._observe("motion", Telemetry, self._telemetry_observers, observer)

    def observe_tracking(self, observer: Callable[[str, TrackingTelemetry], None]) -> None:
        """Call an observer with the robot's name and every batch of samples along a path."""
        self._observe("tracking", TrackingTelemetry, self._tracking_observers, observer)

    def _observe(
        self,
        leaf: str,
        kind: type[R],
        observers: list[Callable[[str, R], None]],
        observer: Callable[[str, R], None],
    ) -> None:
        if not observers:  # without an observer, nothing is sent here
            self._session.subscribe(
                self._keys.every_robot(f"telemetry/{leaf}"),
                partial(self._on_telemetry, kind, observers),
                max_bytes=TELEMETRY_MAX_BYTES,
            )
        observers.append(observer)

    # Requests.

    def describe(self, robot: str) -> Description:
        """Return a robot's description of itself.

        Raises:
            NoReplyError: The robot does not answer.
            RobotLostError: Several agents answer under this name.
        """
        tries = 0
        while True:
            tries += 1
            try:
                return self._requests.ask(robot, "describe", DescribeRequest(), Description)
            except NoReplyError as error:
                if tries < DESCRIBE_TRIES and self.watch(robot).alive:
                    continue
                raise NoReplyError(
                    f"robot {robot} does not answer: is its agent running? "
                    "`nufleet fleet status` lists the robots that are there"
                ) from error

    def describe_all(self, robots: tuple[str, ...]) -> dict[str, Description]:
        """Return the descriptions of several robots, asked at the same time; see `describe`."""
        with ThreadPoolExecutor(min(32, len(robots)), thread_name_prefix="describe") as pool:
            return dict(zip(robots, pool.map(self.describe, robots), strict=True))

    def submit(self, robot: str, request: GoalRequest) -> GoalAccepted:
        """Send a goal to a robot; the same request may safely be sent again at any time."""
        return self._requests.ask(robot, "goal", request, GoalAccepted)

    def submit_later(self, robot: str, request: GoalRequest) -> Reply[GoalAccepted]:
        """Send a goal as `submit` does, without waiting for the reply."""
        return self._requests.ask_later(robot, "goal", request, GoalAccepted)

    def cancel(self, robot: str, goal_id: str) -> None:
        """Ask a robot to end a goal early."""
        sender, epoch = self.orchestrator_id, self.epoch(robot)
        request = CancelRequest(sender=sender, epoch=epoch, goal_id=goal_id)
        self._requests.ask(robot, "cancel", request, Done)

    def result(self, robot: str, goal_id: str) -> GoalResult:
        """Return how a goal ended, with its samples."""
        request = ResultRequest(goal_id=goal_id)
        return self._requests.ask(robot, "result", request, GoalResult, timeout_s=RESULT_TIMEOUT_S)

    def result_later(self, robot: str, goal_id: str) -> Reply[GoalResult]:
        """Ask for a result as `result` does, without waiting for the reply."""
        request = ResultRequest(goal_id=goal_id)
        return self._requests.ask_later(
            robot, "result", request, GoalResult, timeout_s=RESULT_TIMEOUT_S
        )

    def acknowledge(self, robot: str, goal_ids: tuple[str, ...]) -> None:
        """Acknowledge results, so that the robot may discard them."""
        sender, epoch = self.orchestrator_id, self.epoch(robot)
        request = AcknowledgeRequest(sender=sender, epoch=epoch, goal_ids=goal_ids)
        self._requests.ask(robot, "acknowledge", request, Done)

    def fetch(self, robot: str, sha256: str) -> bytes:
        """Return the file of a robot's experience or prior; the caller must check its content.

        Args:
            robot: Name of the robot.
            sha256: SHA-256 digest of the requested file, in hexadecimal.
        """
        request = FetchRequest(sha256=sha256)
        return self._requests.ask(
            robot, "experience", request, ExperienceFile, timeout_s=RESULT_TIMEOUT_S
        ).payload

    def install(
        self,
        robot: str,
        slot: Literal["experience", "prior"],
        payload: bytes,
        sha256: str,
        *,
        beside: bool = False,
    ) -> ExperienceOffer:
        """Install an experience on a robot.

        Args:
            robot: Name of the robot.
            slot: `experience` for the robot's own experience, `prior` for the prior that corrects
                its references.
            payload: Content of the experience file.
            sha256: SHA-256 digest of the payload, in hexadecimal.
            beside: Whether a prior joins those that the robot holds; otherwise it takes their
                place.

        Returns:
            The offer under which the robot now holds the experience.
        """
        sender, epoch = self.orchestrator_id, self.epoch(robot)
        request = InstallRequest(
            sender=sender, epoch=epoch, sha256=sha256, payload=payload, beside=beside
        )
        leaf = f"{slot}/install"
        return self._requests.ask(robot, leaf, request, ExperienceOffer, timeout_s=RESULT_TIMEOUT_S)

    def remove_prior(self, robot: str) -> None:
        """Remove all priors of a robot."""
        request = RemovePriorRequest(sender=self.orchestrator_id, epoch=self.epoch(robot))
        self._requests.ask(robot, "prior/remove", request, Done)

    def forget_own_model(self, robot: str) -> None:
        """Have a robot forget what it knows of itself, its baseline included."""
        request = RemovePriorRequest(
            sender=self.orchestrator_id, epoch=self.epoch(robot), what="own-model"
        )
        self._requests.ask(robot, "prior/remove", request, Done)

    def forecast(
        self,
        robot: str,
        desired: FloatArray,
        ways: Sequence[ForeseenWay],
        *,
        on_foreseen: Callable[[int], None] = lambda done: None,
    ) -> tuple[Foreseen, ...]:
        """Return what a robot expects of ways to follow a path; it takes seconds per way.

        The robot stops predicting when this is left early, by Ctrl-C for example.

        Args:
            robot: Name of the robot, which must be at rest.
            desired: Path, shape (samples, axes), in the unit of the robot's axes.
            ways: Ways of following it.
            on_foreseen: Callback that receives the number of ways that are done.

        Returns:
            The prediction of each way, or the reason why there is none, in the order of the ways.
        """
        request = ForecastRequest(desired=desired, ways=tuple(ways))
        while True:
            reply = self._requests.ask(
                robot, "forecast", request, PathForecast, timeout_s=FORECAST_TIMEOUT_S
            )
            found = tuple(one for one in reply.foreseen if one is not None)
            on_foreseen(len(found))
            if len(found) == len(request.ways):
                return found
            time.sleep(FORECAST_LOOK_S)

    def stop(
        self, robot: str, reason: str, *, kill: bool = False, order_id: str | None = None
    ) -> None:
        """Stop a robot; return once it confirms the stop, and raise if it does not.

        Args:
            robot: Name of the robot.
            reason: Reason for the stop.
            kill: Whether to cut its motors instead of bringing it to rest.
            order_id: Id of an order of which copies have been sent already; None for a new order.
        """
        request = StopRequest(
            sender=self.orchestrator_id,
            reason=reason,
            kill=kill,
            order_id=order_id or new_order_id(),
        )
        if order_id is None:
            self._session.put_urgent(self._requests.key(robot, STOP), encode(request))
        # The question is a stop, too, and every copy costs a fleet that is busy some time.
        self._requests.ask(robot, STOP, request, Done)

    def stop_everyone(self, reason: str) -> None:
        """Send one unconfirmed stop to the whole fleet; call `stop` on each robot to confirm it."""
        request = StopRequest(sender=self.orchestrator_id, reason=reason)
        key = self._keys.stop(principal_of(self.orchestrator_id))
        self._session.put_urgent(key, encode(request))

    def release(self, robot: str) -> None:
        """Let a stopped robot move again."""
        request = ReleaseRequest(sender=self.orchestrator_id)
        self._requests.ask(robot, RELEASE, request, Done, timeout_s=RELEASE_TIMEOUT_S)

    # Network threads.

    def _on_presence(self, key: str, alive: bool) -> None:
        robot = self._robot_of(key)
        if robot is not None:
            self.watch(robot).set_alive(alive)

    def _on_state(self, key: str, payload: bytes) -> None:
        robot = self._robot_of(key)
        state = None if robot is None else state_heard(robot, key, payload)
        if state is not None:
            self._know(state)

    def _on_states(self, key: str, payload: bytes) -> None:
        for state in states_heard(key, payload):
            self._know(state)

    def _know(self, state: RobotState) -> None:
        if self.watch(state.robot).set_state(state):
            for observer in self._state_observers:
                _tell(partial(observer, state))

    def _on_telemetry(
        self, kind: type[R], observers: list[Callable[[str, R], None]], key: str, payload: bytes
    ) -> None:
        robot = self._robot_of(key)
        if robot is None:
            return
        try:
            telemetry = decode(payload, kind)
        except MalformedMessageError as error:
            _log.warning("ignoring malformed telemetry on %s: %s", key, error)
            return
        for observer in observers:
            _tell(partial(observer, robot, telemetry))

    def _robot_of(self, key: str) -> str | None:
        robot = self._keys.robot_of(key)
        if robot is None:
            _log.warning("ignoring %r, which is not a robot's key", key)
        return robot


def _tell(observer: Callable[[], None]) -> None:
    try:
        observer()
    except Exception:  # noqa: BLE001 - one observer's mistake must not blind the others
        _log.exception("an observer failed")
