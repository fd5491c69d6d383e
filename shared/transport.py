"""The network as nufleet uses it: the only module that imports Zenoh.

Handlers given to a session run on Zenoh's own threads: they must only hand the event on and return.
Zero replies to a query is an error with a name, never an empty result.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import Any

import zenoh
from zenoh.ext import (
    CacheConfig,
    HistoryConfig,
    declare_advanced_publisher,
    declare_advanced_subscriber,
)

from shared.errors import EndpointInUseError, NoReplyError, NoRouterError, TransportError

DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"
LEASE_MS = 2000
"""A silent session is given up after this long: what a partition costs to be noticed."""


@dataclass(frozen=True)
class Request:
    """A query that arrived; it must be answered exactly once."""

    key: str
    payload: bytes
    _query: zenoh.Query

    def answer(self, payload: bytes) -> None:
        """Send the reply and end the query; raises TransportError when nobody can hear it."""
        try:
            with self._query as query:
                query.reply(self.key, payload)
        except zenoh.ZError as error:
            raise TransportError(f"replying on {self.key}: {_cause(error)}") from error


class Publisher:
    """Publishes on one key."""

    def __init__(self, put: Callable[[bytes], Any]) -> None:
        self._put = put

    def put(self, payload: bytes) -> None:
        """Send a payload to every subscriber there is now; raises TransportError."""
        try:
            self._put(payload)
        except zenoh.ZError as error:
            raise TransportError(f"publishing: {_cause(error)}") from error


class Session:
    """One open Zenoh session; a context manager, since an unclosed one keeps its process alive."""

    def __init__(self, session: zenoh.Session) -> None:
        self._session = session
        self._declared: list[Any] = []

    def __enter__(self) -> Session:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Withdraw everything declared and close; calling it twice does nothing more."""
        for declared in reversed(self._declared):
            with suppress(zenoh.ZError):  # already withdrawn by its owner, or the link is gone
                declared.undeclare()
        self._declared.clear()
        if not self._session.is_closed():
            self._session.close()  # type: ignore[no-untyped-call]

    def serve(self, key_expr: str, handler: Callable[[Request], None]) -> None:
        """Answer queries on a key expression."""

        def on_query(query: zenoh.Query) -> None:
            payload = query.payload
            body = b"" if payload is None else payload.to_bytes()
            handler(Request(str(query.key_expr), body, query))

        self._declared.append(self._session.declare_queryable(key_expr, on_query))

    def ask(self, key: str, payload: bytes, *, timeout_s: float) -> bytes:
        """Return the one reply to a query on a concrete key.

        Raises:
            NoReplyError: nobody answered in time, or nobody is there to answer.
        """
        replies = self.ask_all(key, payload, timeout_s=timeout_s)
        if not replies:
            raise NoReplyError(f"no answer on {key} within {timeout_s:g} s")
        return replies[0]

    def ask_all(self, key: str, payload: bytes, *, timeout_s: float) -> list[bytes]:
        """Return the replies of everyone who serves a key."""
        try:
            replies = self._session.get(
                key,
                payload=payload,
                timeout=timeout_s,
                target=zenoh.QueryTarget.ALL,
                consolidation=zenoh.ConsolidationMode.NONE,
                congestion_control=zenoh.CongestionControl.BLOCK,
            )
            samples = [reply.ok for reply in replies]
        except zenoh.ZError as error:
            raise TransportError(f"asking on {key}: {_cause(error)}") from error
        # An error reply is Zenoh's own word for a timeout; the handlers here always answer in full.
        return [sample.payload.to_bytes() for sample in samples if sample is not None]

    def put_urgent(self, key: str, payload: bytes) -> None:
        """Send a payload ahead of everything else that waits to be sent."""
        try:
            self._session.put(
                key,
                payload,
                priority=zenoh.Priority.REAL_TIME,
                congestion_control=zenoh.CongestionControl.BLOCK,
                express=True,
            )
        except zenoh.ZError as error:
            raise TransportError(f"sending on {key}: {_cause(error)}") from error

    def state_publisher(self, key: str) -> Publisher:
        """Publish a state whose last value late subscribers also get."""
        publisher = declare_advanced_publisher(
            self._session,
            key,
            cache=CacheConfig(max_samples=1),
            publisher_detection=True,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.INTERACTIVE_HIGH,
        )
        self._declared.append(publisher)
        return Publisher(publisher.put)

    def telemetry_publisher(self, key: str) -> Publisher:
        """Publish measurements of which some may be lost under load."""
        publisher = self._session.declare_publisher(
            key,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.DATA_LOW,
            express=False,
        )
        self._declared.append(publisher)
        return Publisher(publisher.put)

    def subscribe_state(self, key_expr: str, handler: Callable[[str, bytes], None]) -> None:
        """Receive states, the last one of each publisher first."""

        def on_sample(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.payload.to_bytes())

        self._declared.append(
            declare_advanced_subscriber(
                self._session,
                key_expr,
                on_sample,
                history=HistoryConfig(detect_late_publishers=True, max_samples=1),
            )
        )

    def subscribe(self, key_expr: str, handler: Callable[[str, bytes], None]) -> None:
        """Receive what is put on a key expression from now on."""

        def on_sample(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.payload.to_bytes())

        self._declared.append(self._session.declare_subscriber(key_expr, on_sample))

    def declare_alive(self, key: str) -> None:
        """Be seen as alive under a key until the session closes or its process is gone."""
        self._declared.append(self._session.liveliness().declare_token(key))

    def alive(self, key_expr: str, *, timeout_s: float) -> list[str]:
        """Return the keys of the tokens that are alive now."""
        replies = self._session.liveliness().get(key_expr, timeout=timeout_s)
        samples = [reply.ok for reply in replies]
        return sorted({str(sample.key_expr) for sample in samples if sample is not None})

    def watch_alive(self, key_expr: str, handler: Callable[[str, bool], None]) -> None:
        """Report each token that is there, appears (True) or disappears (False)."""

        def on_sample(sample: zenoh.Sample) -> None:
            handler(str(sample.key_expr), sample.kind == zenoh.SampleKind.PUT)

        subscriber = self._session.liveliness().declare_subscriber(
            key_expr, on_sample, history=True
        )
        self._declared.append(subscriber)

    def listening_on(self) -> list[str]:
        """Return the endpoints this router really listens on, with the ports it was given."""
        zid = self._session.info.zid()
        for reply in self._session.get(f"@/{zid}/router", timeout=5.0):
            if reply.ok is not None:
                return list(json.loads(reply.ok.payload.to_string())["locators"])
        raise TransportError("the router does not say where it listens")


@contextmanager
def open_router(listen: list[str], *, connect: list[str] | None = None) -> Iterator[Session]:
    """Open a session that routes messages between all others.

    Args:
        listen: endpoints such as `tcp/0.0.0.0:7447`, `tcp/127.0.0.1:0` or `unixsock-stream//path`.
        connect: other routers to join.

    Raises:
        EndpointInUseError: an endpoint is taken or may not be used.
    """
    config = _base_config("router")
    config.insert_json5("listen/endpoints", json.dumps(listen))
    config.insert_json5("connect/endpoints", json.dumps(connect or []))
    config.insert_json5("adminspace/enabled", "true")
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise EndpointInUseError(
            f"cannot listen on {', '.join(listen)}: {_cause(error)}. Is a router running "
            "there already? Choose another endpoint with --listen"
        ) from error
    with Session(session) as opened:
        yield opened


@contextmanager
def open_client(connect: str, *, timeout_s: float | None) -> Iterator[Session]:
    """Open a session through the router at an endpoint.

    Args:
        connect: the router's endpoint.
        timeout_s: how long to look for it; None waits for ever and survives its restarts.

    Raises:
        NoRouterError: there is none.
    """
    config = _base_config("client")
    config.insert_json5("connect/endpoints", json.dumps([connect]))
    timeout_ms = -1 if timeout_s is None else round(timeout_s * 1000)
    config.insert_json5("connect/timeout_ms", str(timeout_ms))
    config.insert_json5("connect/exit_on_failure", "false" if timeout_s is None else "true")
    try:
        session = zenoh.open(config)
    except zenoh.ZError as error:
        raise NoRouterError(
            f"no router answers at {connect}: start one with `nufleet router` or "
            "`nufleet fleet up FLEET.toml`, or name another with --connect"
        ) from error
    with Session(session) as opened:
        yield opened


def _cause(error: zenoh.ZError) -> str:
    """Return a Zenoh error without the places in Zenoh's source that it mentions."""
    return re.sub(r"\s*at \S+\.rs:\d+\.", "", str(error)).rstrip(". ")


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
        "transport/link/rx/max_message_size": str(128 * 2**20),
    }.items():
        config.insert_json5(key, value)
    return config
