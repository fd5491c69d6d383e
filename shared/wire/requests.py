"""What arrives on the network and what is declared there; errors of Zenoh become typed ones."""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from typing import Any

import zenoh

from nufleet.shared.errors import TransportError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.wire.limits import MAX_MESSAGE_BYTES

ANSWER = zenoh.Encoding.APPLICATION_OCTET_STREAM
"""Encoding that marks an error reply as given by a handler. Zenoh's own error replies, for example
after a timeout, have another encoding."""

_log = logging.getLogger(__name__)


class Request:
    """A query that has arrived; it must be answered exactly once, from any thread."""

    def __init__(self, query: zenoh.Query) -> None:
        self.key = str(query.key_expr)
        self._query = query

    @property
    def is_wildcard(self) -> bool:
        """True if the query addresses many keys at once."""
        return "*" in self.key

    @property
    def size_bytes(self) -> int:
        """Length of the payload in bytes, available without copying it."""
        payload = self._query.payload
        return 0 if payload is None else len(payload)

    @property
    def payload(self) -> bytes:
        """A copy of the query's payload; it cannot be read after the query was answered."""
        payload = self._query.payload
        return b"" if payload is None else payload.to_bytes()

    def answer(self, payload: bytes) -> None:
        """Send the reply and end the query.

        A reply to a query on many keys has no single key to be sent on. It is sent as an error
        reply, which `Session.ask_all` returns like any other.

        Args:
            payload: Reply, one encoded message.

        Raises:
            TransportError: the reply cannot be delivered.
        """
        with transport_errors(f"replying on {self.key}"), self._query as query:
            if self.is_wildcard:
                query.reply_err(payload, encoding=ANSWER)
            else:
                query.reply(self.key, payload)


class Declaration:
    """An object declared on a session: a subscriber, a queryable, a token or a publisher."""

    def __init__(self, declared: Any) -> None:
        self._declared = declared

    def withdraw(self) -> None:
        """Undeclare the object now rather than when the session closes; idempotent.

        A handler that is already running is not interrupted.
        """
        with suppress(zenoh.ZError):  # withdrawn before, or the session is closed
            self._declared.undeclare()


class Publisher(Declaration):
    """Publishes on one key."""

    @property
    def heard(self) -> bool:
        """Whether there is a subscriber; a message that would reach none need not be encoded."""
        with transport_errors("publishing"):
            return bool(self._declared.matching_status.matching)

    def put(self, payload: bytes) -> None:
        """Send a payload to all current subscribers.

        Raises:
            TransportError: Zenoh cannot send it.
        """
        with transport_errors("publishing"):
            self._declared.put(payload)


class Replies:
    """The replies to one query; no thread waits for them, and no thread of Zenoh for this one."""

    def __init__(self, handler: Any) -> None:
        self._handler = handler
        self._said: list[bytes] = []
        self._over = False

    def over(self) -> bool:
        """Return whether all replies have arrived that will; it takes microseconds."""
        while not self._over:
            try:
                reply = self._handler.try_recv()
            except zenoh.ZError:  # the query is over, and all its replies have been received
                self._over = True
                break
            if reply is None:
                break
            said = reply_said(reply)
            if said is not None:
                self._said.append(said)
        return self._over

    def all(self) -> list[bytes]:
        """Return those that have arrived, which are all once they are `over`; maybe none."""
        return self._said


@contextmanager
def transport_errors(doing: str) -> Iterator[None]:
    """Turn an error of Zenoh into a TransportError that says what was being done."""
    try:
        yield
    except zenoh.ZError as error:
        raise TransportError(f"{doing}: {cause_of(error)}") from error


def declaring(key_expr: str) -> AbstractContextManager[None]:
    """Turn an error of Zenoh into a TransportError that names what was being declared."""
    return transport_errors(f"declaring {key_expr}")


def cause_of(error: zenoh.ZError) -> str:
    """Return the cause that the system gave for a Zenoh error, or else the text of the error."""
    system = re.search(r"\(os error (\d+)\)", str(error))
    if system is not None:
        return os.strerror(int(system[1]))
    # The text refers to Zenoh's source files.
    return without_secrets(re.sub(r"\s*at \S+\.rs:\d+\.", "", str(error)).rstrip(". "))


def bounded(payload: zenoh.ZBytes, max_bytes: int, what: str) -> bytes:
    """Return a copy of a payload, or empty bytes, without copying, if it is too long."""
    if len(payload) > max_bytes:
        _log.warning("%d bytes were %s; at most %d are accepted", len(payload), what, max_bytes)
        return b""
    return payload.to_bytes()


def reply_said(reply: zenoh.Reply) -> bytes | None:
    """Return the payload that a handler replied with; None for an error of Zenoh's own."""
    if reply.ok is not None:
        return bounded(reply.ok.payload, MAX_MESSAGE_BYTES, "answered")
    if reply.err is not None and reply.err.encoding == ANSWER:
        return bounded(reply.err.payload, MAX_MESSAGE_BYTES, "answered")
    return None
