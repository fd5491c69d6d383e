"""Networks of their own for processes, and cables between them that can be pulled.

Linux network namespaces with pairs of virtual Ethernet devices. Needs root, and says so: what
cannot be partitioned is not shown to survive a partition.
"""

from __future__ import annotations

import ctypes
import os
import secrets
import subprocess
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

_CLONE_NEWNET = 0x40000000


class NoNamespaceError(AssertionError):
    """This machine makes no network namespaces."""


@dataclass(frozen=True)
class Namespace:
    """A network namespace, by its name for `ip netns`."""

    name: str

    def enter(self) -> None:
        """Make this thread, and the processes that it starts, see this network alone."""
        libc = ctypes.CDLL(None, use_errno=True)
        with Path("/run/netns", self.name).open() as file:
            if libc.setns(file.fileno(), _CLONE_NEWNET) != 0:
                problem = ctypes.get_errno()
                raise OSError(problem, f"{self.name}: {os.strerror(problem)}")

    def ip(self, *arguments: str) -> None:
        """Run `ip` in it."""
        _ip("-n", self.name, *arguments)


@dataclass(frozen=True)
class Cable:
    """What joins a namespace to the hub's; `address` is of the far end."""

    hub: Namespace
    device: str
    far: Namespace
    address: str

    def pull(self) -> None:
        """Let nothing through any more, in either direction, without telling anybody."""
        self.hub.ip("link", "set", self.device, "down")

    def plug_in(self) -> None:
        """Let everything through again."""
        self.hub.ip("link", "set", self.device, "up")


@dataclass(frozen=True)
class Network:
    """A hub with its address on each cable, and the cables by name."""

    hub: Namespace
    cables: dict[str, Cable]

    def hub_address(self, name: str) -> str:
        """Return the hub's address as the far end of a cable sees it."""
        return self.cables[name].address.rpartition(".")[0] + ".1"


@contextmanager
def star(*names: str) -> Iterator[Network]:
    """Make a hub and one namespace for each name, each with a cable to the hub.

    Raises:
        NoNamespaceError: this machine does not allow it.
    """
    mark = secrets.token_hex(3)
    with ExitStack() as stack:
        hub = stack.enter_context(_namespace(f"nf{mark}-hub"))
        cables = {}
        for number, name in enumerate(names):
            far = stack.enter_context(_namespace(f"nf{mark}-{name}"))
            device, prefix = f"v{mark}{number}", f"10.213.{number}"
            other_end = ("peer", "name", "eth0", "netns", far.name)
            hub.ip("link", "add", device, "type", "veth", *other_end)
            hub.ip("address", "add", f"{prefix}.1/24", "dev", device)
            far.ip("address", "add", f"{prefix}.2/24", "dev", "eth0")
            hub.ip("link", "set", device, "up")
            far.ip("link", "set", "eth0", "up")
            cables[name] = Cable(hub, device, far, f"{prefix}.2")
        yield Network(hub, cables)


@contextmanager
def _namespace(name: str) -> Iterator[Namespace]:
    try:
        _ip("netns", "add", name)
    except (OSError, subprocess.CalledProcessError) as error:
        said = getattr(error, "stderr", None) or str(error)
        raise NoNamespaceError(
            "cannot make a network namespace, so partitions cannot be tested here: run as root, in "
            f"a container with CAP_SYS_ADMIN and CAP_NET_ADMIN, with iproute2 installed ({said})"
        ) from error
    try:
        namespace = Namespace(name)
        namespace.ip("link", "set", "lo", "up")
        yield namespace
    finally:
        _ip("netns", "del", name)


def _ip(*arguments: str) -> None:
    subprocess.run(["ip", *arguments], check=True, capture_output=True, text=True)
