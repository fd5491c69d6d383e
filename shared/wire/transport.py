"""The network as nufleet uses it: the only module that imports Zenoh.

Each handler given to a session runs on a thread of its own, fed by Zenoh; it must only hand the
event on and return. A query without any reply is a typed error, never an empty result.
"""

from __future__ import annotations

import json
import logging
import os
import re
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

import zenoh
from zenoh.ext import (
    CacheConfig,
    HistoryConfig,
    declare_advanced_publisher,
    declare_advanced_subscriber,
)

from nufleet.shared.errors import (
    EndpointInUseError,
    InvalidInputError,
    NoRouterError,
    TransportError,
    system_errors_as,
)
from nufleet.shared.private_files import check_private
from nufleet.shared.redaction import without_secrets
from nufleet.shared.wire.handshake import why_refused
from nufleet.shared.wire.identity import Identity, identity_at
from nufleet.shared.wire.keys import DEFAULT_PRINCIPAL, FleetKeys
from nufleet.shared.wire.openness import LOCAL_ENDPOINT, check_closed
from nufleet.shared.wire.presence import OnPresence, Presence

DEFAULT_ENDPOINT = LOCAL_ENDPOINT
PRESENCE_TIMEOUT_S = 3.0
"""Longest wait for the liveliness tokens that exist when a watch begins."""

PRESENCE_SETTLED_S = 1.0
"""Longest wait for a watch to report tokens that existed before it; it normally takes milliseconds.
"""

LEASE_MS = 2000
"""Time after which a silent session is considered lost, and thus the delay in noticing a partition.
"""

FULL_LINK_WAIT_US = 250_000
"""Time that a router waits for a blocked link before closing it.

Meanwhile all other messages of the same sender wait too, including a stop of other robots. Zenoh's
default of 5 s lets 4 MB through a link of 20 Mbit/s; this value lets 1 MB through a link of
10 Mbit/s (measured).
"""

MAX_MESSAGE_BYTES = 16 * 2**20
"""Largest message of any kind that a session accepts: a computer with 1 GB of memory must survive a
sender of larger ones."""

MAX_STATE_BYTES = 64 * 1024
"""Largest state that a subscriber accepts; real ones take a few kilobytes at most."""

PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws", "unixsock-stream")
"""Protocols with which an endpoint may begin."""

ADMITTED = "@/*/router"
"""Key expression of what a router says about itself; it answers each principal in its list."""

_LINKS = "@/*/session/transport/unicast/*/link/*"
"""Key expression of what a router tells itself about its links, and who is behind each."""

ADMITTED_TIMEOUT_S = 3.0
"""Longest wait for a router's answer to the question whether it lists an identity."""

LONGEST_TRY_S = 3.0
"""Longest duration of one attempt to reach a router, during which Zenoh cannot be interrupted."""

OnSample = Callable[[str, bytes], None]
"""Handler that takes the key of a put and its payload."""

_log = logging.getLogger(__name__)
_ANSWER = zenoh.Encoding.APPLICATION_OCTET_STREAM
"""Encoding that marks an error reply as given by a handler. Zenoh's own error replies, for example
after a timeout, have another encoding."""


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
        with _transport_errors(f"replying on {self.key}"), self._query as query:
            if self.is_wildcard:
                query.reply_err(payload, encoding=_ANSWER)
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

    def put(self, payload: bytes) -> None:
        """Send a payload to all current subscribers.

        Raises:
            TransportError: Zenoh cannot send it.
        """
        with _transport_errors("publishing"):
            self._declared.put(payload)


D = TypeVar("D", bound=Declaration)


class Session:
    """An open Zenoh session; a context manager, because an unclosed one keeps its process alive."""

    def __init__(self, session: zenoh.Session, identity: Identity | None = None) -> None:
        self._session = session
        self._declarations: list[Declaration] = []
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
        with _transport_errors("asking the router"):
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
                _log.exception("a query on %s could not be answered", query.key_expr)
                query.drop()  # type: ignore[no-untyped-call]

        with _declaring(key_expr):
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
        with _transport_errors(f"asking on {key}"):
            replies = self._session.get(
                key,
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            return [said for reply in replies if (said := _said(reply)) is not None]

    def put_urgent(self, key: str, payload: bytes) -> None:
        """Send a payload ahead of all other messages that are waiting to be sent.

        Raises:
            TransportError: Zenoh cannot send it.
        """
        with _transport_errors(f"sending on {key}"):
            self._session.put(
                key,
                payload,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )

    def state_publisher(self, key: str) -> Publisher:
        """Declare a publisher of a state, whose last value late subscribers receive too."""
        with _declaring(key):
            declared = declare_advanced_publisher(
                self._session,
                key,
                cache=CacheConfig(max_samples=1),
                publisher_detection=True,
                congestion_control=zenoh.CongestionControl.DROP,
                priority=zenoh.Priority.INTERACTIVE_HIGH,
            )
        return self._kept(Publisher(declared))

    def telemetry_publisher(self, key: str) -> Publisher:
        """Declare a publisher of measurements, some of which may be lost under load."""
        with _declaring(key):
            declared = self._session.declare_publisher(
                key,
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
        with _declaring(key_expr):
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
        with _declaring(key_expr):
            declared = self._session.declare_subscriber(key_expr, on_sample, allowed_origin=origin)
        return self._kept(Declaration(declared))

    def declare_alive(self, key: str) -> Declaration:
        """Declare a liveliness token, alive until it is withdrawn or the process ends."""
        with _declaring(key):
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
        with _transport_errors(f"looking for {key_expr}"):
            replies = self._session.liveliness().get(key_expr, timeout=timeout_s)
            samples = [reply.ok for reply in replies]
        return sorted({str(sample.key_expr) for sample in samples if sample is not None})

    def watch_alive(self, key_expr: str, handler: OnPresence) -> Declaration:
        """Report tokens that exist or appear (True) and tokens that disappear (False).

        Tokens that exist now are reported before this method returns.

        Args:
            key_expr: Key expression of the tokens.
            handler: Function called with each change, once per change.
        """
        presence = Presence(handler)
        presence.asked(self.alive(key_expr, timeout_s=PRESENCE_TIMEOUT_S))

        def on_sample(sample: zenoh.Sample) -> None:
            presence.watched(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        with _declaring(key_expr):
            declared = self._session.liveliness().declare_subscriber(
                key_expr, on_sample, history=True
            )
        declaration = self._kept(Declaration(declared))
        presence.settle(timeout_s=PRESENCE_SETTLED_S)
        return declaration

    def listening_on(self) -> list[str]:
        """Return the endpoints that this router actually listens on, with their assigned ports.

        Raises:
            TransportError: the router does not report its endpoints.
        """
        with _transport_errors("asking the router"):
            zid = self._session.info.zid()
            for reply in self._session.get(f"@/{zid}/router", timeout=5.0):
                if reply.ok is not None:
                    return list(json.loads(reply.ok.payload.to_string())["locators"])
        raise TransportError("the router does not report the endpoints on which it listens")

    def _kept(self, declaration: D) -> D:
        self._declarations.append(declaration)
        return declaration


@contextmanager
def open_router(listen: list[str], *, connect: list[str] | None = None) -> Iterator[Session]:
    """Open a session that routes messages between all others.

    Args:
        listen: Endpoints to listen on, such as `tcp/0.0.0.0:7447`, `tcp/127.0.0.1:0` or
            `unixsock-stream//path`.
        connect: Endpoints of other routers to link with, now or as soon as they are there.

    Raises:
        InvalidInputError: an endpoint is malformed.
        EndpointInUseError: an endpoint is taken or may not be used.
    """
    config = _base_config("router")
    _insert_endpoints(config, "listen", listen)
    _insert_endpoints(config, "connect", connect or [])
    config.insert_json5("adminspace/enabled", "true")
    waits = "transport/link/tx/queue/congestion_control/block/wait_before_close"
    config.insert_json5(waits, str(FULL_LINK_WAIT_US))
    with _opened_router(config, ", ".join(listen)) as opened:
        yield opened


@contextmanager
def open_configured_router(path: Path, *, allow_open: bool) -> Iterator[Session]:
    """Open a router with the settings of a Zenoh configuration file.

    Args:
        path: Configuration file in JSON5.
        allow_open: Whether it may listen where every machine could command the robots.

    Raises:
        InvalidInputError: the file is not a Zenoh configuration, or is open, or other users can
            read the key of the router.
        EndpointInUseError: one of its endpoints is taken or may not be used.
    """
    try:
        config = zenoh.Config.from_file(path)
    except zenoh.ZError as error:
        raise InvalidInputError(f"{path}: not a Zenoh configuration: {_cause(error)}") from error
    _resolve_certificates(config, path.absolute().parent)
    listen = json.loads(config.get_json("listen/endpoints"))
    connect = json.loads(config.get_json("connect/endpoints"))
    for endpoints in (listen, connect):
        for endpoint in endpoints if isinstance(endpoints, list) else endpoints.get("router", []):
            check_closed(endpoint, allow_open=allow_open)
    fleet = (json.loads(config.get_json("metadata")) or {}).get("fleet")
    with _opened_router(config, f"the endpoints of {path}") as opened:
        if fleet is not None:
            opened.tell_connected(FleetKeys(fleet).connected)
        yield opened


def _resolve_certificates(config: zenoh.Config, folder: Path) -> None:
    """Make the names of certificates and keys relative to the folder of their configuration."""
    for name in ("root_ca_certificate", "listen_certificate", "listen_private_key"):
        key = f"transport/link/tls/{name}"
        value = json.loads(config.get_json(key))
        if isinstance(value, str):
            if name == "listen_private_key":
                with system_errors_as(InvalidInputError, f"{folder / value}: cannot be read"):
                    check_private(folder / value)
            config.insert_json5(key, json.dumps(str(folder / value)))


@contextmanager
def _opened_router(config: zenoh.Config, endpoints: str) -> Iterator[Session]:
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise EndpointInUseError(
            f"cannot listen on {without_secrets(endpoints)}: {_cause(error)}. Is a router running "
            "there already? Choose another endpoint with --listen"
        ) from error
    with Session(session) as opened:
        yield opened


@contextmanager
def open_client(
    connect: str, *, timeout_s: float | None, given_up: threading.Event | None = None
) -> Iterator[Session]:
    """Open a session through the router at an endpoint; it survives restarts of the router.

    Args:
        connect: Endpoint of the router, or the address of an identity (`identity/FILE`), which
            holds the endpoint.
        timeout_s: Longest time to try to reach the router; None tries forever.
        given_up: Event that ends the attempts when it is set from another thread.

    Raises:
        InvalidInputError: the endpoint is malformed.
        IdentityError: the identity cannot be used.
        NoRouterError: no router answered, or it refused the identity; the message says why.
    """
    identity = identity_at(connect)
    config = _base_config("client")
    _insert_endpoints(config, "connect", [connect if identity is None else identity.router])
    config.insert_json5("connect/exit_on_failure", "true")
    if identity is not None:
        config.insert_json5("transport/link/protocols", '["tls"]')
        config.insert_json5("transport/link/tls", json.dumps(identity.zenoh_settings()))
    reached = _reach(config, connect, identity, timeout_s, given_up)
    with Session(reached, identity) as opened:
        yield opened


def _insert_endpoints(config: zenoh.Config, role: str, endpoints: list[str]) -> None:
    for endpoint in endpoints:
        protocol, _, address = endpoint.partition("/")
        if protocol not in PROTOCOLS or not address:
            raise InvalidInputError(
                f"{without_secrets(endpoint)!r} is not an endpoint: expected "
                f"{' or '.join(PROTOCOLS)}, a slash and an address, for example "
                "tcp/192.168.1.5:7447"
            )
    config.insert_json5(f"{role}/endpoints", json.dumps(endpoints))


def _reach(
    config: zenoh.Config,
    connect: str,
    identity: Identity | None,
    timeout_s: float | None,
    given_up: threading.Event | None,
) -> zenoh.Session:
    """Open a client session in short attempts, because `zenoh.open` cannot be interrupted."""
    deadline = None if timeout_s is None else time.monotonic() + timeout_s
    try_s = 0.2
    tries = 0
    while True:
        try_s = min(1.5 * try_s, LONGEST_TRY_S)
        left_s = try_s if deadline is None else deadline - time.monotonic()
        wait_ms = max(1, round(1000 * min(try_s, left_s)))
        config.insert_json5("connect/timeout_ms", str(wait_ms))
        try:
            return zenoh.open(config)
        except zenoh.ZError as error:
            over = deadline is not None and time.monotonic() >= deadline
            if over or (given_up is not None and given_up.is_set()):
                raise NoRouterError(_no_router(connect, identity)) from error
            # A failed handshake makes a router wait for 0.1 s before it accepts others.
            # An open router that is started beside its agents answers some tries later.
            first = 0 if identity is not None else 5
            if deadline is None and tries % 10 == first:
                _log.warning("%s; it tries again", _no_router(connect, identity))
            tries += 1


def _no_router(connect: str, identity: Identity | None) -> str:
    if identity is None:
        return (
            f"no router answers at {without_secrets(connect)}: start one with `nufleet router` or "
            "`nufleet fleet up FLEET.toml`, or give another address with --connect"
        )
    why = why_refused(identity.now()) or "its handshake succeeds, so the router may be overloaded"
    return f"{identity.principal} cannot reach the router at {identity.router}: {why}"


def _on_sample(handler: OnSample, max_bytes: int) -> Callable[[zenoh.Sample], None]:
    def on_sample(sample: zenoh.Sample) -> None:
        key = str(sample.key_expr)
        handler(key, _bounded(sample.payload, max_bytes, f"put on {key!r}"))

    return on_sample


def _bounded(payload: zenoh.ZBytes, max_bytes: int, what: str) -> bytes:
    """Return a copy of a payload, or empty bytes, without copying, if it is too long."""
    if len(payload) > max_bytes:
        _log.warning("%d bytes were %s; at most %d are accepted", len(payload), what, max_bytes)
        return b""
    return payload.to_bytes()


def _said(reply: zenoh.Reply) -> bytes | None:
    """Return the payload that a handler replied with; None for an error of Zenoh's own."""
    if reply.ok is not None:
        return _bounded(reply.ok.payload, MAX_MESSAGE_BYTES, "answered")
    if reply.err is not None and reply.err.encoding == _ANSWER:
        return _bounded(reply.err.payload, MAX_MESSAGE_BYTES, "answered")
    return None


@contextmanager
def _transport_errors(doing: str) -> Iterator[None]:
    try:
        yield
    except zenoh.ZError as error:
        raise TransportError(f"{doing}: {_cause(error)}") from error


def _declaring(key_expr: str) -> AbstractContextManager[None]:
    return _transport_errors(f"declaring {key_expr}")


def _cause(error: zenoh.ZError) -> str:
    """Return the cause that the system gave for a Zenoh error, or else the text of the error."""
    system = re.search(r"\(os error (\d+)\)", str(error))
    if system is not None:
        return os.strerror(int(system[1]))
    # The text refers to Zenoh's source files.
    return without_secrets(re.sub(r"\s*at \S+\.rs:\d+\.", "", str(error)).rstrip(". "))


def _base_config(mode: str) -> zenoh.Config:
    zenoh.try_init_log_from_env()  # type: ignore[no-untyped-call]
    config = zenoh.Config()
    for key, value in {
        "mode": json.dumps(mode),
        "listen/endpoints": "[]",
        "scouting/multicast/enabled": "false",
        "scouting/gossip/enabled": "false",
        "scouting/delay": "0",
        "timestamping/enabled": "true",
        "transport/shared_memory/enabled": "false",
        "transport/link/tx/lease": str(LEASE_MS),
        "transport/link/tx/keep_alive": "4",
        "transport/link/rx/max_message_size": str(MAX_MESSAGE_BYTES),
    }.items():
        config.insert_json5(key, value)
    return config
