"""Halts a robot where a stop arrives, and stores the stop without anything waiting for the disk."""

from __future__ import annotations

import logging
import threading
from concurrent.futures import Future, ThreadPoolExecutor

from nufleet.robot_agent.decisions import Decisions
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.network.endpoint import MAX_REQUEST_BYTES, SHUTTING_DOWN
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.codec import Message, decode
from nufleet.shared.wire.messages import Done, Refusal, StopRequest

_log = logging.getLogger(__name__)


class StopService:
    """Takes the stops of one robot, on Zenoh's threads; one thread of its own stores them."""

    def __init__(self, robot: str, decisions: Decisions) -> None:
        self._robot = robot
        self._decisions = decisions
        self._writer = ThreadPoolExecutor(1, thread_name_prefix=f"{robot}-stops")
        self._lock = threading.Lock()
        self._storing: Future[Message] | None = None
        self._closed = False

    def heard(self, key: str, payload: bytes) -> None:
        """Take a stop that nobody waits for an answer to."""
        try:
            self.asked(payload)
        except MalformedMessageError as error:
            _log.warning("%s: malformed stop on %s: %s", self._robot, key, error)

    def asked(self, payload: bytes) -> Future[Message]:
        """Take a stop; the motion has been told to end when this returns.

        The answer comes when the stop is stored too, so that who hears a yes knows that the robot
        stays stopped whatever becomes of its agent.

        Raises:
            MalformedMessageError: it is none. The robot is stopped all the same.
        """
        try:
            request = decode(payload, StopRequest, max_bytes=MAX_REQUEST_BYTES)
        except MalformedMessageError as error:
            # Somebody wants this robot to stop; that the order is garbled does not make it move on.
            self._decisions.stop(StopOrder("unknown", f"a malformed stop: {error}"))
            self._stored()
            raise
        self._decisions.stop(StopOrder(request.sender, request.reason))
        return self._stored()

    def close(self) -> None:
        """Store what was taken and end."""
        with self._lock:
            self._closed = True
        self._writer.shutdown()

    def _stored(self) -> Future[Message]:
        """Return the answer to come; stops that wait for the disk together share one."""
        with self._lock:
            if self._closed:
                ended: Future[Message] = Future()
                ended.set_result(SHUTTING_DOWN)
                return ended
            waits = self._storing
            if waits is None or waits.running() or waits.done():
                # One that is being stored may have looked before this stop was given.
                waits = self._storing = self._writer.submit(self._store)
            return waits

    def _store(self) -> Message:
        try:
            self._decisions.store_stop()
        except JournalError as error:
            _log.error("%s: a stop is not stored: %s", self._robot, error)
            forgotten = "it was halted, but the stop would not outlast its agent"
            return Refusal(code="journal", reason=f"{forgotten}: {error}")
        return Done()
