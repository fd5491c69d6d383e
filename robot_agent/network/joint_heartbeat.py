"""Sends the heartbeats of all robots that share a session in common messages.

A state that says something new is sent by itself and at once. One that only says that its robot is
still there waits a little for those of the others: most of what a heartbeat costs the agent, the
router and each orchestrator is the message, not the state in it.
"""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Mapping

from nufleet.shared.errors import MalformedMessageError, NufleetError
from nufleet.shared.wire.bundle import bundled, unbundled
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.limits import MAX_STATES_BYTES
from nufleet.shared.wire.requests import Publisher
from nufleet.shared.wire.session import Session

GATHER_S = 0.1
"""Longest time for which a heartbeat waits for others, a small part of the silence after which a
robot counts as lost (`orchestrator.fleet.robot_watch.HEARTBEAT_LOST_S`)."""

OnState = Callable[[str, bytes], None]
"""Function that takes the key of a message and an encoded state in it."""

_log = logging.getLogger(__name__)


class JointHeartbeat:
    """A thread that sends the heartbeats of the robots of one session; all methods are for any
    thread."""

    def __init__(self, session: Session, keys: FleetKeys) -> None:
        """Begin to listen, and to send what is handed in.

        Args:
            session: Session that the robots share, in an open fleet.
            keys: Keys of their fleet.
        """
        self._lock = threading.Lock()
        self._due: dict[str, bytes] = {}
        self._any = threading.Event()
        self._closing = threading.Event()
        self._listeners: dict[str, OnState] = {}
        self._publisher = session.states_publisher(keys.states)
        self._others = session.subscribe(
            keys.states, self._on_states, max_bytes=MAX_STATES_BYTES, own=False
        )
        self._thread = threading.Thread(target=self._send, name="joint-heartbeat", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the thread; what is still due is not sent."""
        self._closing.set()
        self._any.set()
        self._thread.join()
        self._others.withdraw()
        self._publisher.withdraw()

    def hand_in(self, robot: str, state: bytes) -> None:
        """Send a state soon, together with those of other robots.

        Args:
            robot: Name of the robot.
            state: Its state, encoded.
        """
        with self._lock:
            self._due[robot] = state
        self._any.set()

    def overtake(self, robot: str, publisher: Publisher, state: bytes) -> None:
        """Send a state now and by itself, in place of one that was handed in.

        Args:
            robot: Name of the robot.
            publisher: Publisher of this robot's states.
            state: Its state, encoded.

        Raises:
            TransportError: It cannot be sent.
        """
        with self._lock:
            self._due.pop(robot, None)
            publisher.put(state)

    def listen(self, robot: str, heard: OnState) -> Callable[[], None]:
        """Have a robot hear the states that others publish under its name.

        Args:
            robot: Name of the robot.
            heard: Function called with each such state, on Zenoh's thread.

        Returns:
            Function that ends this.
        """
        self._listeners[robot] = heard
        return lambda: self._forget(robot)

    def _forget(self, robot: str) -> None:
        del self._listeners[robot]

    def _send(self) -> None:
        while not self._closing.is_set():
            self._any.wait()
            self._any.clear()
            self._closing.wait(GATHER_S)
            # Under the lock, so that no state arrives after a later one of the same robot.
            with self._lock:
                due, self._due = self._due, {}
                try:
                    for message in bundled(due, most_bytes=MAX_STATES_BYTES):
                        self._publisher.put(message)
                except NufleetError as error:
                    _log.warning("heartbeats could not be sent: %s", error)

    def _on_states(self, key: str, payload: bytes) -> None:
        hear_among(self._listeners, key, payload)


def hear_among(listeners: Mapping[str, OnState], key: str, payload: bytes) -> None:
    """Pass on the states of those robots that have a listener.

    Args:
        listeners: Functions to call, by the robot's name.
        key: Key of the message.
        payload: Message with states of many robots.
    """
    try:
        for robot, state in unbundled(payload):
            heard = listeners.get(robot)
            if heard is not None:
                heard(key, state)
    except MalformedMessageError as error:
        _log.warning("ignoring malformed states on %s: %s", key, error)
