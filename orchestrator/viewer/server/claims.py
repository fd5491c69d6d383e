"""Checks that files can be written and ports listened on, before a study relies on them."""

from __future__ import annotations

import socket
from collections.abc import Collection
from pathlib import Path

from nufleet.shared.errors import EndpointInUseError, InvalidInputError, system_errors_as


def claim_recording(path: Path) -> Path:
    """Create an empty recording and return its path.

    Raises:
        InvalidInputError: The file exists already, or cannot be written.
    """
    with system_errors_as(InvalidInputError, f"the recording cannot be written to {path}"):
        try:
            path.open("xb").close()
        except FileExistsError:
            raise InvalidInputError(
                f"{path} already exists; name a different file for the recording"
            ) from None
    return path


def claim_port(bind_ip: str, port: int, *, apart_from: Collection[int | None] = ()) -> int:
    """Return the port to listen on.

    Args:
        bind_ip: Address of the network interface.
        port: Port that is wanted; 0 for any free one.
        apart_from: Ports that were claimed before and that nothing listens on yet; the system may
            call them free again.

    Raises:
        EndpointInUseError: The port is in use, or may not be listened on.
    """
    family = socket.AF_INET6 if ":" in bind_ip else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind((bind_ip, port))
            probe.listen()
        except (OSError, OverflowError) as error:
            reason = getattr(error, "strerror", None) or str(error)
            raise EndpointInUseError(
                f"the viewer cannot listen on {bind_ip}:{port}: {reason}; choose another port"
            ) from error
        found = int(probe.getsockname()[1])
        if port == 0 and found in apart_from:
            # The probe keeps the port while another one is looked for.
            return claim_port(bind_ip, 0, apart_from=apart_from)
        return found


def reachable(bind_ip: str) -> str:
    """Return the address under which this machine reaches a server that listens on `bind_ip`."""
    return {"0.0.0.0": "127.0.0.1", "::": "::1"}.get(bind_ip, bind_ip)  # noqa: S104 - compared only


def host_in_url(ip: str) -> str:
    """Return an IP address in the notation of URLs, IPv6 in brackets."""
    return f"[{ip}]" if ":" in ip else ip
