"""Publishes the states of the robots of one session: at every change, and twice a second.

A state that says something new is sent by itself and at once. In an open fleet, those that only say
that their robots are still there, or how far they have come, share messages: most of what a
heartbeat costs the agent, the router and each orchestrator is the message, not the state in it. One
thread beats for all robots of a session, because what remains is mostly the waking up of threads.
"""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from operator import attrgetter

from nufleet.shared.errors import MalformedMessageError, NufleetError
from nufleet.shared.wire.bundle import bundled, unbundled
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.limits import MAX_STATES_BYTES
from nufleet.shared.wire.messages import RobotState
from nufleet.shared.wire.requests import Publisher
from nufleet.shared.wire.session import Session

HEARTBEAT_S = 0.5
"""Interval between two states while nothing changes, a small part of the silence after which a
robot counts as lost (`orchestrator.fleet.robot_watch.HEARTBEAT_LOST_S`)."""

TELLING_S = 0.2
"""Time in s for robots to tell their news one by one, before all of them speak together."""

LEAST_S = 0.004
"""Least interval between two states. The router of a closed fleet drops states that come more than
twice as fast (`orchestrator.authority.access.STATES_HZ`), and the last of several must arrive."""

OnState = Callable[[str, bytes], None]
"""Function that takes the key of a message and an encoded state in it."""

_PASSING = ("sequence", "robot_time_s", "progress")
_lasting = attrgetter(*(name for name in RobotState.model_fields if name not in _PASSING))
"""Returns the values of a state without what changes with time alone."""

_log = logging.getLogger(__name__)


@dataclass
class _Member:
    publisher: Publisher
    state: Callable[[], RobotState]
    heard: OnState
    said: tuple[object, ...] | None = None
    sent_s: float = 0.0

    def send(self, state: RobotState, frame: bytes) -> None:
        """Publish a state by itself, as the frame that encodes it."""
        self.publisher.put(frame)
        self.said, self.sent_s = _lasting(state), time.monotonic()


class Heartbeat:
    """A thread that publishes states; changes in quick succession share one message."""

    def __init__(self, session: Session, keys: FleetKeys) -> None:
        """Begin, without robots.

        Args:
            session: Session of the robots.
            keys: Keys of their fleet.
        """
        self._session, self._keys = session, keys
        self._members: dict[str, _Member] = {}
        # Held while states are sent, so that none arrives after a later one of the same robot.
        self._sending = threading.Lock()
        # Robots are marked under locks that the functions which return their states take as well.
        self._marked: deque[str] = deque()
        self._wake = threading.Event()
        self._closing = threading.Event()
        # In a closed fleet each robot speaks for itself.
        is_open = session.identity is None
        self._common = session.states_publisher(keys.states) if is_open else None
        self._others = (
            session.subscribe(keys.states, self._on_states, max_bytes=MAX_STATES_BYTES, own=False)
            if is_open
            else None
        )
        self._thread = threading.Thread(target=self._work, name="heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; all robots must have left."""
        self._closing.set()
        self._wake.set()
        self._thread.join()
        for declaration in (self._others, self._common):
            if declaration is not None:
                declaration.withdraw()

    def change(self, robot: str) -> threading.Event:
        """Return an event to set after a change of a robot's state, so that it is published soon.

        Args:
            robot: Name of the robot, which may join later.
        """
        return _Change(partial(self._mark, robot))

    def join(
        self, robot: str, state: Callable[[], RobotState], heard: OnState
    ) -> Callable[[], None]:
        """Begin to publish the states of a robot.

        Args:
            robot: Name of the robot.
            state: Function that returns its present state.
            heard: Function called with each state that another program publishes under the robot's
                name together with others, on Zenoh's thread.

        Returns:
            Function that publishes the final state, and ends this.
        """
        publisher = self._session.state_publisher(self._keys.robot(robot, "state"))
        with self._sending:
            self._members[robot] = _Member(publisher, state, heard)
        self._mark(robot)
        return partial(self._leave, robot)

    def _leave(self, robot: str) -> None:
        with self._sending:
            member = self._members.pop(robot)
            self._closing.wait(max(0.0, member.sent_s + LEAST_S - time.monotonic()))
            said = self._said(robot, member)
            try:
                if said is not None:
                    member.send(*said)
            except NufleetError as error:
                _unsent(error)
        member.publisher.withdraw()

    def _mark(self, robot: str) -> None:
        self._marked.append(robot)
        self._wake.set()

    def _work(self) -> None:
        due_s = time.monotonic()
        while not self._closing.is_set():
            self._wake.wait(max(0.0, due_s - time.monotonic()))
            self._wake.clear()
            robots = dict.fromkeys(self._marked.popleft() for _ in range(len(self._marked)))
            with self._sending:
                try:
                    if time.monotonic() >= due_s:
                        robots = dict.fromkeys(self._beat())
                        due_s = time.monotonic() + HEARTBEAT_S
                    if not self._tell([robot for robot in robots if robot in self._members]):
                        due_s = time.monotonic()  # which finds those that have yet to speak
                except Exception:  # noqa: BLE001 - the next one may go well
                    _log.exception("a heartbeat failed")
            self._closing.wait(LEAST_S)

    def _beat(self) -> list[str]:
        """Publish all states in common messages; return the robots that have yet to speak.

        They are those whose states say something new; in a closed fleet, and if there is only one,
        all.
        """
        if self._common is None or len(self._members) == 1:
            return list(self._members)
        together: dict[str, bytes] = {}
        news = []
        for robot, member in self._members.items():
            said = self._said(robot, member)
            if said is not None:
                state, together[robot] = said
                if _lasting(state) != member.said:
                    news.append(robot)
        self._publish(together)
        return news

    def _tell(self, robots: list[str]) -> bool:
        """Publish what is new of some robots; return False if that takes too long for the others.

        Each message lets all other threads of the process go first. Where hundreds of robots begin
        to move, they all would seem to be lost before the last of them has spoken.
        """
        together: dict[str, bytes] = {}
        until_s = time.monotonic() + TELLING_S
        for robot in robots:
            if self._common is not None and time.monotonic() >= until_s:
                return False
            member = self._members[robot]
            said = self._said(robot, member)
            if said is None:
                continue
            state, frame = said
            if self._common is not None and len(robots) > 1 and _lasting(state) == member.said:
                together[robot] = frame
                continue
            try:
                member.send(state, frame)
            except NufleetError as error:
                _unsent(error)
        self._publish(together)
        return True

    def _said(self, robot: str, member: _Member) -> tuple[RobotState, bytes] | None:
        """Return a robot's present state and its frame; None if it cannot tell it."""
        try:
            state = member.state()
            return state, encode(state)
        except Exception:  # noqa: BLE001 - it counts as lost; the others are not to
            _log.exception("%s cannot tell its state", robot)
            return None

    def _publish(self, together: dict[str, bytes]) -> None:
        if self._common is not None:
            try:
                for message in bundled(together, most_bytes=MAX_STATES_BYTES):
                    self._common.put(message)
            except NufleetError as error:
                _unsent(error)

    def _on_states(self, key: str, payload: bytes) -> None:
        try:
            for robot, state in unbundled(payload):
                member = self._members.get(robot)
                if member is not None:
                    member.heard(key, state)
        except MalformedMessageError as error:
            _log.warning("ignoring malformed states on %s: %s", key, error)


class _Change(threading.Event):
    """An event that also calls a function when it is set."""

    def __init__(self, mark: Callable[[], None]) -> None:
        super().__init__()
        self._mark = mark

    def set(self) -> None:
        super().set()
        self._mark()


def _unsent(error: NufleetError) -> None:
    _log.warning("a heartbeat could not be sent: %s", error)
