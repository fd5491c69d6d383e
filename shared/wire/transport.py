"""Opens the network: routers, and sessions that reach one, in an open fleet or with an identity."""

from __future__ import annotations

import json
import logging
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import zenoh

from nufleet.shared.errors import (
    EndpointInUseError,
    InvalidInputError,
    NoRouterError,
    system_errors_as,
)
from nufleet.shared.private_files import check_private
from nufleet.shared.redaction import without_secrets
from nufleet.shared.wire.handshake import why_refused
from nufleet.shared.wire.identity import Identity, identity_at
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.limits import FULL_LINK_WAIT_US, LEASE_MS, MAX_MESSAGE_BYTES
from nufleet.shared.wire.openness import LOCAL_ENDPOINT, check_closed
from nufleet.shared.wire.requests import cause_of
from nufleet.shared.wire.session import Session

DEFAULT_ENDPOINT = LOCAL_ENDPOINT

PROTOCOLS = ("tcp", "tls", "quic", "udp", "ws", "unixsock-stream")
"""Protocols with which an endpoint may begin."""

LONGEST_TRY_S = 3.0
"""Longest duration of one attempt to reach a router, during which Zenoh cannot be interrupted."""

STATES_WAITING = 16
"""Batches of 64 KiB that wait for a session that is slow to read, at the priority of the states.

The states of 500 robots fill three batches. What finds no room is dropped, and of a robot whose
states are dropped for seconds it seems that it went silent.
"""

_log = logging.getLogger(__name__)


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
        raise InvalidInputError(f"{path}: not a Zenoh configuration: {cause_of(error)}") from error
    _resolve_certificates(config, path.absolute().parent)
    listen = json.loads(config.get_json("listen/endpoints"))
    connect = json.loads(config.get_json("connect/endpoints"))
    anonymous = json.loads(config.get_json("transport/link/tls/enable_mtls")) is not True
    for endpoints, of_others in ((listen, anonymous), (connect, False)):
        for endpoint in endpoints if isinstance(endpoints, list) else endpoints.get("router", []):
            check_closed(endpoint, allow_open=allow_open, anonymous=of_others)
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
        cause = cause_of(error)
        taken = "Is a router running there already? " if "in use" in cause else ""
        raise EndpointInUseError(
            f"cannot listen on {without_secrets(endpoints)}: {cause}. {taken}Choose another "
            "endpoint with --listen"
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
        "transport/link/tx/queue/size/interactive_high": str(STATES_WAITING),
        "transport/link/rx/max_message_size": str(MAX_MESSAGE_BYTES),
    }.items():
        config.insert_json5(key, value)
    return config
