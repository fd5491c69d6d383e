"""An open session on the network: all that a program of a fleet does there, in keys and bytes.

Each handler given to a session runs on a thread of its own, fed by Zenoh; it must only hand the
event on and return. A query without any reply is a typed error, never an empty result.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from functools import partial
from typing import TypeVar

import zenoh
from zenoh.ext import (
    CacheConfig,
    HistoryConfig,
    declare_advanced_publisher,
    declare_advanced_subscriber,
)

from nufleet.shared.errors import NoRouterError, TransportError
from nufleet.shared.wire.identity import Identity
from nufleet.shared.wire.keys import ADMITTED, DEFAULT_PRINCIPAL, FleetKeys
from nufleet.shared.wire.limits import MAX_STATE_BYTES
from nufleet.shared.wire.presence import OnPresence, Presence
from nufleet.shared.wire.requests import (
    Declaration,
    Publisher,
    Replies,
    Request,
    bounded,
    declaring,
    reply_said,
    transport_errors,
)

PRESENCE_TIMEOUT_S = 3.0
"""Longest wait for the liveliness tokens that exist when a watch begins."""

PRESENCE_SETTLED_S = 1.0
"""Longest wait for a watch to report tokens that existed before it; it normally takes milliseconds.
"""

ADMITTED_TIMEOUT_S = 3.0
"""Longest wait for a router's answer to the question whether it lists an identity."""

_LINKS = "@/*/session/transport/unicast/*/link/*"
"""Key expression of what a router tells itself about its links, and who is behind each."""

OnSample = Callable[[str, bytes], None]
"""Handler that takes the key of a put and its payload."""

_log = logging.getLogger(__name__)
D = TypeVar("D", bound=Declaration)


class Session:
    """An open Zenoh session; a context manager, because an unclosed one keeps its process alive."""

    def __init__(self, session: zenoh.Session, identity: Identity | None = None) -> None:
        self._session = session
        self._declarations: list[Declaration] = []
        self._watching = threading.Lock()
        self._watches: dict[str, tuple[Presence, Declaration]] = {}
        self.identity = identity
        """Identity with which the session was opened; None in an open fleet."""

    @property
    def principal(self) -> str:
        """Name under which requests are sent."""
        return DEFAULT_PRINCIPAL if self.identity is None else self.identity.principal

    def check_admitted(self) -> None:
        """Check that the router of a closed fleet lists the identity of this session.

        A router silently drops all that it does not allow. The one question that it answers to
        every principal in its list tells a revoked identity from a fleet without robots.

        Raises:
            NoRouterError: The router does not answer.
        """
        if self.identity is not None:
            self._ask_router(self.identity)

    def admitted_robots(self) -> frozenset[str]:
        """Return the common names under which the router of a closed fleet admits robots now.

        Raises:
            NoRouterError: The router does not answer, or its configuration does not say so.
        """
        if self.identity is None:
            return frozenset()
        try:
            return frozenset(json.loads(self._ask_router(self.identity))["metadata"]["robots"])
        except (ValueError, KeyError, TypeError) as error:
            raise NoRouterError(
                f"the router at {self.identity.router} does not say which robots it admits: write "
                "its configuration again with `nufleet fleet renew --router`, and restart it"
            ) from error

    def connected(self) -> frozenset[str]:
        """Return the common names of the certificates with which programs are connected now.

        The router of a closed fleet tells them to orchestrators only; for others, this is empty.

        Raises:
            TransportError: Zenoh cannot send the query.
        """
        if self.identity is None:
            return frozenset()
        key = FleetKeys(self.identity.fleet).connected
        replies = self.ask_all(key, b"", timeout_s=ADMITTED_TIMEOUT_S)
        return frozenset(name for reply in replies for name in json.loads(reply))

    def tell_connected(self, key: str) -> None:
        """Answer on a key, as a router, with the common names of `connected`."""

        def answer(request: Request) -> None:
            links = self._session.get(_LINKS, timeout=ADMITTED_TIMEOUT_S)
            said = [json.loads(link.ok.payload.to_bytes()) for link in links if link.ok is not None]
            names = {name for link in said if (name := link.get("auth_identifier"))}
            request.answer(json.dumps(sorted(names)).encode())

        self.serve(key, answer)

    def _ask_router(self, identity: Identity) -> bytes:
        """Return what the router of a closed fleet says about itself, as JSON."""
        with transport_errors("asking the router"):
            for reply in self._session.get(ADMITTED, timeout=ADMITTED_TIMEOUT_S):
                if reply.ok is not None:
                    return reply.ok.payload.to_bytes()
        raise NoRouterError(
            f"{identity.principal} ({identity.path}) is not in the list of the router at "
            f"{identity.router}: it was revoked, or the router was not restarted since it was "
            "added to the inventory"
        )

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Withdraw all declarations and close the session; idempotent."""
        for declaration in reversed(self._declarations):
            declaration.withdraw()
        self._declarations.clear()
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def serve(self, key_expr: str, handler: Callable[[Request], None]) -> Declaration:
        """Answer queries on a key expression.

        Args:
            key_expr: Key expression to serve.
            handler: Function that answers a request or hands it on. If it raises, the error is
                logged and the query dropped, so that the sender does not wait for its timeout.

        Raises:
            TransportError: Zenoh cannot declare the queryable.
        """

        def on_query(query: zenoh.Query) -> None:
            try:
                handler(Request(query))
            except Exception:  # noqa: BLE001 - the sender must not wait for a handler's mistake
                _log.exception("a query on %r could not be answered", str(query.key_expr))
                query.drop()  # type: ignore[no-untyped-call]

        with declaring(key_expr):
            declared = self._session.declare_queryable(key_expr, on_query)
        return self._kept(Declaration(declared))

    def ask_all(self, key: str, payload: bytes, *, timeout_s: float) -> list[bytes]:
        """Return the replies of all who serve a key; the list may be empty.

        Args:
            key: Key or key expression to query.
            payload: Request, one encoded message.
            timeout_s: Longest wait for all replies.

        Raises:
            TransportError: Zenoh cannot send the query.
        """
        with transport_errors(f"asking on {key}"):
            replies = self._query(key, payload, timeout_s)
            return [said for reply in replies if (said := reply_said(reply)) is not None]

    def ask(self, key: str, payload: bytes, *, timeout_s: float) -> Replies:
        """Send a query and return its replies, which have not arrived yet.

        Args:
            key: Key or key expression to query.
            payload: Request, one encoded message.
            timeout_s: Longest time until all replies have arrived.

        Raises:
            TransportError: Zenoh cannot send the query.
        """
        with transport_errors(f"asking on {key}"):
            return Replies(self._query(key, payload, timeout_s))

    def _query(
        self, key: str, payload: bytes, timeout_s: float
    ) -> zenoh.handlers.Handler[zenoh.Reply]:
        return self._session.get(
            key,
            payload=payload,
            timeout=timeout_s,
            target=zenoh.QueryTarget.ALL,
            consolidation=zenoh.ConsolidationMode.NONE,
            congestion_control=zenoh.CongestionControl.BLOCK,
        )

    def put_urgent(self, key: str, payload: bytes) -> None:
        """Send a payload ahead of all other messages that are waiting to be sent.

        Raises:
            TransportError: Zenoh cannot send it.
        """
        with transport_errors(f"sending on {key}"):
            self._session.put(
                key,
                payload,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )

    def state_publisher(self, key: str) -> Publisher:
        """Declare a publisher of a state, whose last value late subscribers receive too."""
        with declaring(key):
            declared = declare_advanced_publisher(
                self._session,
                key,
                cache=CacheConfig(max_samples=1),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
            )
        return self._kept(Publisher(declared))

    def states_publisher(self, key: str) -> Publisher:
        """Declare a publisher of several robots' states, which are sent again and again."""
        with declaring(key):
            declared = self._session.declare_publisher(
                key,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
            )
        return self._kept(Publisher(declared))

    def telemetry_publisher(self, key: str) -> Publisher:
        """Declare a publisher of measurements, some of which may be lost under load.

        They reach other sessions only. A listener would otherwise be looked for among all that this
        session itself subscribes to, which takes 60 µs for 250 robots, not 1.
        """
        with declaring(key):
            declared = self._session.declare_publisher(
                key,
                allowed_destination=zenoh.Locality.REMOTE,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.DATA_LOW,
                express=False,
            )
        return self._kept(Publisher(declared))

    def subscribe_state(self, key_expr: str, handler: OnSample) -> Declaration:
        """Receive states, beginning with the last one of each publisher.

        Args:
            key_expr: Key expression of the states.
            handler: Function called with each state, in a thread of Zenoh. States above
                `MAX_STATE_BYTES` arrive as an empty payload, see `subscribe`.
        """
        on_sample = _on_sample(handler, MAX_STATE_BYTES)
        history = HistoryConfig(detect_late_publishers=True, max_samples=1)
        with declaring(key_expr):
            declared = declare_advanced_subscriber(
                self._session, key_expr, on_sample, history=history
            )
        return self._kept(Declaration(declared))

    def subscribe(
        self, key_expr: str, handler: OnSample, *, max_bytes: int, own: bool = True
    ) -> Declaration:
        """Receive all puts on a key expression from now on.

        Args:
            key_expr: Key expression to subscribe to.
            handler: Function called with each put, in a thread of Zenoh.
            max_bytes: Longest payload that is copied. For a longer one the handler receives an
                empty payload, which is not a valid message but shows that there was a put.
            own: Whether to receive what this session itself puts.
        """
        on_sample = _on_sample(handler, max_bytes)
        origin = zenoh.Locality.ANY if own else zenoh.Locality.REMOTE
        with declaring(key_expr):
            declared = self._session.declare_subscriber(key_expr, on_sample, allowed_origin=origin)
        return self._kept(Declaration(declared))

    def declare_alive(self, key: str) -> Declaration:
        """Declare a liveliness token, alive until it is withdrawn or the process ends."""
        with declaring(key):
            declared = self._session.liveliness().declare_token(key)
        return self._kept(Declaration(declared))

    def alive(self, key_expr: str, *, timeout_s: float) -> list[str]:
        """Return the keys of the tokens that are alive now, sorted.

        Call this before `watch_alive`. In a session with a watch, Zenoh answers from the tokens
        that the watch has received until then, at first none (measured: the answer was wrong in 7
        of 10 cases right after the watch began).

        Args:
            key_expr: Key expression of the tokens.
            timeout_s: Longest wait for the answer.

        Raises:
            TransportError: Zenoh cannot send the query.
        """
        with transport_errors(f"looking for {key_expr}"):
            replies = self._session.liveliness().get(key_expr, timeout=timeout_s)
            samples = [reply.ok for reply in replies]
        return sorted({str(sample.key_expr) for sample in samples if sample is not None})

    def watch_alive(self, key_expr: str, handler: OnPresence) -> Declaration:
        """Report tokens that exist or appear (True) and tokens that disappear (False).

        Tokens that exist now are reported before this method returns. All who watch the same tokens
        on this session share one watch, since Zenoh would answer the second from what the first has
        heard until then; see `alive`.

        Args:
            key_expr: Key expression of the tokens.
            handler: Function called with each change, once per change.
        """
        with self._watching:
            known = self._watches.get(key_expr)
            if known is None:
                self._watches[key_expr] = self._watched(key_expr, handler)
            else:
                known[0].join(handler)
        return Declaration(_Watch(partial(self._unwatch, key_expr, handler)))

    def _watched(self, key_expr: str, handler: OnPresence) -> tuple[Presence, Declaration]:
        presence = Presence(handler)
        presence.asked(self.alive(key_expr, timeout_s=PRESENCE_TIMEOUT_S))

        def on_sample(sample: zenoh.Sample) -> None:
            presence.watched(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        with declaring(key_expr):
            declared = self._session.liveliness().declare_subscriber(
                key_expr, on_sample, history=True
            )
        declaration = self._kept(Declaration(declared))
        presence.settle(timeout_s=PRESENCE_SETTLED_S)
        return presence, declaration

    def _unwatch(self, key_expr: str, handler: OnPresence) -> None:
        with self._watching:
            presence, declaration = self._watches[key_expr]
            if not presence.leave(handler):
                del self._watches[key_expr]
                declaration.withdraw()

    def listening_on(self) -> list[str]:
        """Return the endpoints that this router actually listens on, with their assigned ports.

        Raises:
            TransportError: the router does not report its endpoints.
        """
        with transport_errors("asking the router"):
            zid = self._session.info.zid()
            for reply in self._session.get(f"@/{zid}/router", timeout=5.0):
                if reply.ok is not None:
                    return list(json.loads(reply.ok.payload.to_string())["locators"])
        raise TransportError("the router does not report the endpoints on which it listens")

    def linked_to(self) -> list[str]:
        """Return the Zenoh identifiers of the routers that this session has a link to."""
        return [str(zid) for zid in self._session.info.routers_zid()]

    def hears(self, router: str) -> bool | None:
        """Return whether what a router declares is known here; None where it is only slow.

        A question about something that is not known is over at once, without any answer.

        Args:
            router: Zenoh identifier of the router.

        Raises:
            TransportError: the session is closed.
        """
        with transport_errors("asking the router"):
            replies = list(self._session.get(f"@/{router}/router", timeout=PRESENCE_TIMEOUT_S))
        if any(reply.ok is not None for reply in replies):
            return True
        return None if replies else False

    def _kept(self, declaration: D) -> D:
        self._declarations.append(declaration)
        return declaration


class _Watch:
    """One handler's part in a watch, which ends once."""

    def __init__(self, end: Callable[[], None]) -> None:
        self._end: Callable[[], None] | None = end

    def undeclare(self) -> None:
        end, self._end = self._end, None
        if end is not None:
            end()


def _on_sample(handler: OnSample, max_bytes: int) -> Callable[[zenoh.Sample], None]:
    def on_sample(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        handler(key, bounded(sample.payload, max_bytes, f"put on {key!r}"))

    return on_sample
