"""Ports of this machine for programs that have to be told theirs."""

from __future__ import annotations

import itertools
import os
import socket
from contextlib import suppress
from pathlib import Path

_FIRST = 20_000
_EPHEMERAL = int(Path("/proc/sys/net/ipv4/ip_local_port_range").read_text().split()[0])
_PLACES = itertools.count(97 * os.getpid())
"""Where this process looks next; others begin elsewhere."""


def free_port() -> int:
    """Return a port on which no program listens, and that the system gives to none by itself.

    One that the system gives away could be another program's before it is listened on.
    """
    while True:
        port = _FIRST + next(_PLACES) % (_EPHEMERAL - _FIRST)
        with suppress(OSError), socket.socket() as probe:
            probe.bind(("127.0.0.1", port))
            return port
