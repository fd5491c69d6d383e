"""Halts a robot as soon as a stop arrives; storing the stop makes no motion wait for the disk."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable
from concurrent.futures import Executor, Future, wait
from functools import partial

from nufleet.robot_agent.commands import Commands
from nufleet.robot_agent.decisions import Decisions
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.network.endpoint import MAX_REQUEST_BYTES, SHUTTING_DOWN
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.codec import Message, decode
from nufleet.shared.wire.frame import NOT_KILLED
from nufleet.shared.wire.keys import FleetKeys, principal_of
from nufleet.shared.wire.messages import Done, Refusal, StopRequest

RELEASED = Refusal(code="released", reason="it obeyed this stop, and was released since")

_log = logging.getLogger(__name__)


class StopService:
    """Handles the stops of one robot on Zenoh's threads; another thread stores them."""

    def __init__(
        self,
        robot: str,
        decisions: Decisions,
        keys: FleetKeys,
        commands: Commands,
        kill: Callable[[], None],
        *,
        writer: Executor,
    ) -> None:
        """Handle no stop yet.

        Args:
            robot: Name of the robot.
            decisions: Decisions of its agent.
            keys: Keys of its fleet.
            commands: Record of what its agent was told.
            kill: The driver's `kill`.
            writer: What stores stops, which outlives this.
        """
        self._robot = robot
        self._decisions = decisions
        self._keys = keys
        self._commands = commands
        self._kill = kill
        self._killing: tuple[str | None, Future[Message]] | None = None
        self._writer = writer
        self._lock = threading.Lock()
        self._storing: Future[Message] | None = None
        self._closed = False

    def heard(self, key: str, payload: bytes) -> None:
        """Handle a stop sent as a put; no reply is expected."""
        self.halted(key, payload)()

    def halted(self, key: str, payload: bytes) -> Callable[[], None]:
        """Halt the motion for a stop sent as a put.

        Returns:
            Function that does the rest: cuts the motors if asked to, records and stores the stop.
        """
        finish = self._halted(self._keys.principal_of_stop(key), payload)

        def rest() -> None:
            try:
                finish()
            except MalformedMessageError as error:
                _log.warning("%s: malformed stop on %r: %s", self._robot, key, error)

        return rest

    def asked(self, principal: str | None, payload: bytes) -> Future[Message]:
        """Handle a stop sent as a query; the motion has been halted when this returns.

        A stop is obeyed from every sender; the order names the principal that the key proves. Only
        another copy of a stop that has been released since is refused.

        Returns:
            The reply to come. It is sent once the stop is stored too, so that a confirmed stop
            outlasts the agent.

        Raises:
            MalformedMessageError: The payload is not a stop request. The robot is stopped anyway.
        """
        return self._halted(principal, payload)()

    def _halted(self, principal: str | None, payload: bytes) -> Callable[[], Future[Message]]:
        try:
            request = decode(payload, StopRequest, max_bytes=MAX_REQUEST_BYTES)
        except MalformedMessageError as error:
            # The sender wants this robot to stop, so a garbled order stops it as well.
            self._decisions.stop(StopOrder(principal or "unknown", f"a malformed stop: {error}"))
            return partial(self._garbled, principal, error)
        proven = principal is None or principal_of(request.sender) == principal
        sender = request.sender if proven else f"{principal}.as-{request.sender}"[:200]
        order = StopOrder(sender, request.reason, request.order_id)
        obeyed = self._decisions.stop(order, kill=request.kill)
        return partial(self._obeyed if obeyed else self._released, principal, request, order)

    def _garbled(self, principal: str | None, error: MalformedMessageError) -> Future[Message]:
        self._stored()
        self._commands.stopped(principal, None)
        raise error

    def _released(
        self, principal: str | None, request: StopRequest, order: StopOrder
    ) -> Future[Message]:
        self._commands.stopped(principal, request, answer=f"refused {RELEASED.code}")
        return _known(RELEASED)

    def _obeyed(
        self, principal: str | None, request: StopRequest, order: StopOrder
    ) -> Future[Message]:
        killing = self._cut_motors(order) if request.kill else None
        self._commands.stopped(principal, request)
        stored = self._stored()
        return stored if killing is None else _both(killing, stored)

    def close(self) -> None:
        """Store the stops that have been handled, and end."""
        with self._lock:
            self._closed = True
        if self._storing is not None:
            wait([self._storing])

    def _cut_motors(self, order: StopOrder) -> Future[Message]:
        """Cut the motors, and return the reply to come.

        Orders in the meantime share it, and so do late copies of an order that has cut them: a
        robot is not released while its motors are cut again for nothing. The stop is in force
        already, and is stored beside this.
        """
        with self._lock:
            if self._killing is not None:
                order_id, answer = self._killing
                copied = order_id is not None and order_id == order.order_id
                if not answer.done() or (copied and isinstance(answer.result(), Done)):
                    return answer
            answer = Future()
            self._killing = order.order_id, answer

        def cut() -> None:
            try:
                self._kill()
            except Exception as error:  # noqa: BLE001 - the sender is told, of a driver's mistake too
                _log.error("%s: its motors could not be cut: %r", self._robot, error)
                text = f"it was stopped, but its motors were not cut: {error}"
                self._decisions.cut(None)
                answer.set_result(Refusal(code=NOT_KILLED, reason=text))
            else:
                self._decisions.cut(f"its motors were cut by {order.sender}: {order.reason}")
                answer.set_result(Done())

        self._decisions.cutting()
        self._start(cut)
        return answer

    def _start(self, work: Callable[[], None]) -> None:
        """Begin work of the driver on a thread that is never waited for, since it may hang."""
        threading.Thread(target=work, name=f"{self._robot}-kill", daemon=True).start()

    def _stored(self) -> Future[Message]:
        """Return the reply to come; stops that wait for the disk at the same time share it."""
        with self._lock:
            if self._closed:
                return _known(SHUTTING_DOWN)
            waits = self._storing
            if waits is None or waits.running() or waits.done():
                # A write in progress may have read the state before this stop was recorded.
                waits = self._storing = self._writer.submit(self._store)
            return waits

    def _store(self) -> Message:
        try:
            self._decisions.store_stop()
        except JournalError as error:
            _log.error("%s: a stop could not be stored: %s", self._robot, error)
            forgotten = "it was halted, but the stop will not outlast its agent"
            return Refusal(code="journal", reason=f"{forgotten}: {error}")
        return Done()


def _known(answer: Message) -> Future[Message]:
    future: Future[Message] = Future()
    future.set_result(answer)
    return future


def _both(killing: Future[Message], stored: Future[Message]) -> Future[Message]:
    """Return the reply to come when the motors are cut and the stop is stored: what went wrong."""
    answer: Future[Message] = Future()

    def cut(_: object) -> None:
        stored.add_done_callback(ended)

    def ended(_: object) -> None:
        cut_or_not = killing.result()
        answer.set_result(stored.result() if isinstance(cut_or_not, Done) else cut_or_not)

    killing.add_done_callback(cut)
    return answer
