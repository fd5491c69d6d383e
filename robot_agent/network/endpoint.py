"""Answers the queries on one robot's keys, in order and within bounds.

Zenoh's thread only puts a query into a short queue, from which one worker answers. Urgent queries
are the exception: they are answered on Zenoh's thread, so that they never wait behind others.
"""

from __future__ import annotations

import logging
import queue
import threading
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import CancelledError, Future
from contextlib import suppress
from functools import partial
from typing import TypeVar

from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.shared.errors import (
    DamagedMessageError,
    MalformedMessageError,
    RefusedError,
    TransportError,
)
from nufleet.shared.wire.codec import Message, encode
from nufleet.shared.wire.keys import FleetKeys, attributed
from nufleet.shared.wire.messages import Refusal
from nufleet.shared.wire.requests import Request
from nufleet.shared.wire.session import Session

MAX_REQUEST_BYTES = 64 * 1024
"""Largest size of an ordinary request."""

MAX_LARGE_REQUEST_BYTES = 8 * 2**20
"""Largest size of a request that carries a path or an experience."""

MAX_WAITING_REQUESTS = 64
"""Largest number of requests that wait in the queue."""

MAX_WAITING_BYTES = 2 * MAX_LARGE_REQUEST_BYTES
"""Largest total size of the requests that wait in the queue."""

Answer = Message | Future[Message]
Handler = Callable[[bytes], Answer]
"""Function that takes a payload and returns the reply or its future; it may raise RefusedError,
JournalError or MalformedMessageError."""

CommandHandler = Callable[[str, str, bytes], Answer]
"""Handler of a command, which also takes the principal that the key names, and the end of the key.
"""

StopHandler = Callable[[str | None, bytes], Answer]
"""Handler of a stop, whose key may name no principal."""

A = TypeVar("A")
_log = logging.getLogger(__name__)
SHUTTING_DOWN = Refusal(code="shutting-down", reason="this agent is shutting down")


class Endpoint:
    """Serves every key of a robot; each query gets one reply, if only a refusal."""

    def __init__(
        self,
        session: Session,
        keys: FleetKeys,
        robot: str,
        *,
        handlers: Mapping[str, Handler],
        commands: Mapping[str, CommandHandler],
        urgent: Mapping[str, StopHandler],
        large: Collection[str] = (),
    ) -> None:
        """Begin to serve.

        Args:
            session: Session on which to serve.
            keys: Keys of the robot's fleet.
            robot: Name of the robot.
            handlers: Handlers of the queries, by the part of their key behind the robot's name; all
                are called from one thread.
            commands: Handlers of the queries on keys that name a principal, by the part of their
                key behind that name; called from the same thread.
            urgent: Handlers of the queries that cannot wait, called from Zenoh's thread.
            large: Ends of keys whose requests may have up to `MAX_LARGE_REQUEST_BYTES`.
        """
        self._prefix = keys.robot(robot, "")
        self._handlers = handlers
        self._commands = commands
        self._urgent = urgent
        self._large = frozenset(large)
        self._lock = threading.Lock()
        self._closed = False
        self._waiting_bytes = 0
        self._waiting: queue.Queue[Request | None] = queue.Queue(MAX_WAITING_REQUESTS)
        self._worker = threading.Thread(target=self._work, name=f"{robot}-requests", daemon=True)
        self._worker.start()
        self._declaration = session.serve(keys.robot(robot, "**"), self._on_request)

    def close(self) -> None:
        """Stop serving; requests that still wait are refused."""
        self._declaration.withdraw()
        with self._lock:
            self._closed = True
        with suppress(queue.Empty):
            while (request := self._waiting.get_nowait()) is not None:
                _send(request, SHUTTING_DOWN)
        self._waiting.put(None)
        self._worker.join()

    def _on_request(self, request: Request) -> None:
        principal, leaf = self._parsed(request)
        urgent = self._urgent.get(request.key.rpartition("/")[2] if request.is_wildcard else leaf)
        most = MAX_LARGE_REQUEST_BYTES if leaf in self._large else MAX_REQUEST_BYTES
        too_large = request.size_bytes > most
        if urgent is not None:
            # An urgent query must not be refused for its size, so an oversized payload is dropped
            # and the query answered without it.
            _reply(request, partial(urgent, principal, b"" if too_large else request.payload))
        elif request.is_wildcard:
            _send(request, Refusal(code="wildcard", reason="ask each robot on its own key"))
        elif self._handler(principal, leaf) is None:
            reason = f"this robot does not serve {request.key.removeprefix(self._prefix)[:200]!r}"
            _send(request, Refusal(code="unknown-key", reason=reason))
        elif too_large:
            reason = f"the request has {request.size_bytes} bytes; at most {most} are accepted"
            _send(request, Refusal(code="too-large", reason=reason))
        else:
            refusal = self._enqueue(request)
            if refusal is not None:
                _send(request, refusal)

    def _enqueue(self, request: Request) -> Refusal | None:
        with self._lock:
            if self._closed:
                return SHUTTING_DOWN
            size_bytes = request.size_bytes
            too_long = self._waiting_bytes + size_bytes > MAX_WAITING_BYTES
            if too_long or self._waiting.full():
                return Refusal(code="overloaded", reason="too many requests are waiting")
            self._waiting_bytes += size_bytes
            self._waiting.put_nowait(request)
        return None

    def _work(self) -> None:
        while (request := self._waiting.get()) is not None:
            with self._lock:
                self._waiting_bytes -= request.size_bytes
            handler = self._handler(*self._parsed(request))
            if handler is not None:  # it was found when the request was enqueued
                _reply(request, partial(handler, request.payload))

    def _parsed(self, request: Request) -> tuple[str | None, str]:
        """Return the principal that a request's key names, if any, and the end of the key."""
        if request.is_wildcard:
            return attributed(f"by/{request.key.rpartition('/by/')[2]}")
        return attributed(request.key.removeprefix(self._prefix))

    def _handler(self, principal: str | None, leaf: str) -> Handler | None:
        if principal is None:
            return self._handlers.get(leaf)
        command = self._commands.get(leaf)
        return None if command is None else partial(command, principal, leaf)


def _reply(request: Request, ask: Callable[[], Answer]) -> None:
    answer = _answered(ask)
    if isinstance(answer, Future):
        answer.add_done_callback(lambda done: _send(request, _answered(done.result)))
    else:
        _send(request, answer)


def _answered(ask: Callable[[], A]) -> A | Refusal:
    """Return the answer; turn every exception into a refusal."""
    try:
        return ask()
    except RefusedError as error:
        return Refusal(code=error.code, reason=error.reason)
    except DamagedMessageError as error:
        return Refusal(code="damaged", reason=str(error))
    except MalformedMessageError as error:
        return Refusal(code="malformed", reason=str(error))
    except JournalError as error:
        return Refusal(code="journal", reason=str(error))
    except CancelledError:
        return SHUTTING_DOWN
    except Exception as error:  # noqa: BLE001 - one bad request must not end the agent
        _log.exception("a request could not be answered")
        return Refusal(code="internal-error", reason=repr(error))


def _send(request: Request, answer: Message) -> None:
    try:
        payload = encode(answer)
    except MalformedMessageError as error:
        payload = encode(Refusal(code="too-large", reason=str(error)))
    try:
        request.answer(payload)
    except TransportError as error:
        _log.warning("the reply on %r was lost: %s", request.key, error)
