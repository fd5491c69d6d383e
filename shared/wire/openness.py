"""Which endpoints any machine could use, and how a command is told the fleet that it is for."""

from __future__ import annotations

import ipaddress
import os
from pathlib import Path

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.wire.identity import (
    IDENTITY_VARIABLE,
    IdentityError,
    address_of,
    found_identities,
    read_identity,
)

LOCAL_ENDPOINT = "tcp/127.0.0.1:7447"
OPEN_VARIABLE = "NUFLEET_OPEN"
PLAIN_PROTOCOLS = ("tcp", "udp", "ws")
"""Protocols that prove neither side to the other."""

PROVING_PROTOCOLS = ("tls", "quic")
"""Protocols that prove a router to those who connect, and also those to the router if it asks."""

HOW_TO_CLOSE = (
    "close the fleet with `nufleet fleet init INVENTORY` and give each machine an identity "
    "(docs/security.md), or accept this with --open on a network of the fleet's own"
)


def is_open(endpoint: str, *, anonymous: bool = False) -> bool:
    """Return whether an endpoint admits other machines without proof of who they are.

    Args:
        endpoint: Endpoint to listen on or to connect to.
        anonymous: Whether a router listens there that asks for no certificates.
    """
    protocol, _, address = endpoint.partition("/")
    asks = not anonymous or "enable_mtls=true" in address.partition("#")[2].split(";")
    if protocol not in PLAIN_PROTOCOLS and (asks or protocol not in PROVING_PROTOCOLS):
        return False
    host = address.partition("#")[0].partition("?")[0].rpartition(":")[0]
    return not is_this_machine(host.strip("[]"))


def is_this_machine(host: str) -> bool:
    """Return whether a host name or IP address reaches this machine alone."""
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False


def check_closed(endpoint: str, *, allow_open: bool, anonymous: bool = False) -> str:
    """Return an endpoint that may be used.

    Args:
        endpoint: Endpoint to listen on or to connect to.
        allow_open: Whether the user accepts an open fleet.
        anonymous: Whether a router listens there that asks for no certificates.

    Raises:
        InvalidInputError: The endpoint is open and this was not accepted.
    """
    if allow_open or not is_open(endpoint, anonymous=anonymous):
        return endpoint
    raise InvalidInputError(
        f"{without_secrets(endpoint)} is open: every machine that reaches it could command the "
        f"robots; {HOW_TO_CLOSE}"
    )


def chosen_address(connect: str | None, identity: Path | None, *, allow_open: bool) -> str:
    """Return the one address of a fleet that `chosen_addresses` finds.

    Raises:
        IdentityError: There are several identities in the user's folder.
        InvalidInputError: The endpoint is open and this was not accepted.
    """
    found = chosen_addresses(connect, identity, allow_open=allow_open)
    if len(found) > 1:
        names = ", ".join(str(path) for path in kept_identities(of_robots=False))
        raise IdentityError(
            f"which identity? {names}: choose one with --identity or {IDENTITY_VARIABLE}"
        )
    return found[0]


def chosen_addresses(
    connect: str | None, identity: Path | None, *, allow_open: bool
) -> tuple[str, ...]:
    """Return the addresses of fleets from what the user gave, or else from where they are kept.

    The order is: an identity that was given (option or NUFLEET_IDENTITY), an endpoint that was
    given (option or NUFLEET_ROUTER), the identities in the user's folder, this machine. A script
    that is given an endpoint in NUFLEET_ROUTER thus never uses the identity of its user.

    Args:
        connect: Endpoint that was given; None for none.
        identity: Identity file that was given; None for none.
        allow_open: Whether the user accepts an open fleet.

    Raises:
        InvalidInputError: The endpoint is open and this was not accepted.
    """
    if identity is not None:
        return (address_of(identity),)
    if connect is None:
        return tuple(map(address_of, kept_identities(of_robots=False))) or (LOCAL_ENDPOINT,)
    return (check_closed(connect, allow_open=allow_open),)


def kept_identities(*, of_robots: bool) -> tuple[Path, ...]:
    """Return the identities in the user's folder that are for agents, or for all other programs.

    A user who tries a fleet on one machine has both. A file that cannot be read may be of either
    kind. If no file is of the kind that is asked for, all are returned, so that the error that
    follows names them.
    """
    found = found_identities()
    return tuple(path for path in found if _may_be(path, of_robots=of_robots)) or found


def _may_be(path: Path, *, of_robots: bool) -> bool:
    try:
        return (read_identity(path).role == "robot") == of_robots
    except IdentityError:
        return True


def open_is_accepted() -> bool:
    """Return whether the environment accepts an open fleet."""
    return os.environ.get(OPEN_VARIABLE, "") not in ("", "0")
