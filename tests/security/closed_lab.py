"""A closed fleet in a folder: its inventory, authority and identities, and sessions of them."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from polling import PATIENCE_S
from ports import free_port

from nufleet.orchestrator.authority.authority import Authority
from nufleet.orchestrator.authority.certificates import Issuer, read_issuers, read_key
from nufleet.shared.wire.identity import address_of
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.requests import Request
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client, open_configured_router

KEYS = FleetKeys("lab")
ROBOT = '[robots.{}]\ndriver = "double_integrator"\nsettings = {{ alpha = 1.0, beta = 0.003 }}\n'
OTHERS = """
[orchestrators.desk]
[orchestrators.laptop]
[orchestrators.thief]
[operators.anna]
[operators.otto]
may_release = true
[watchers.screen]
"""


def inventory_text(port: int, *robots: str, addresses: str = '"127.0.0.1"') -> str:
    """An inventory whose router listens on this machine alone."""
    router = f'[router]\naddresses = [{addresses}]\nport = {port}\nlisten = "127.0.0.1"\n'
    return f'schema = 1\nname = "lab"\n{router}{OTHERS}{"".join(map(ROBOT.format, robots))}'


@dataclass
class ClosedLab:
    """A closed fleet; sessions are opened under the names of its principals."""

    folder: Path
    stack: ExitStack
    authority: Authority = field(init=False)

    def __post_init__(self) -> None:
        inventory = self.folder / "lab.toml"
        inventory.write_text(inventory_text(free_port(), "a", "b", "c"))
        self.authority = Authority.create(inventory, self.folder / "lab.authority")

    def identity(self, name: str) -> Path:
        """The identity file of a principal, which is enrolled when it is first asked for."""
        path = self.folder / "identities" / f"{name}.nufleet"
        if not path.exists():
            self.authority.enroll(name, path.parent)
        return path

    @property
    def issuer(self) -> Issuer:
        """What signs for this fleet, with which tests make certificates of their own."""
        folder = self.authority.folder
        key = read_key((folder / "authority.key").read_bytes(), "its key")
        return read_issuers((folder / "authority.pem").read_bytes(), key)[0]

    def start_router(self) -> None:
        """Open the router with the configuration as it is now."""
        opened = open_configured_router(self.authority.configuration, allow_open=False)
        self.stack.enter_context(opened)

    def session(self, name: str) -> Session:
        """A session under the identity of a principal."""
        address = address_of(self.identity(name))
        return self.stack.enter_context(open_client(address, timeout_s=PATIENCE_S))


@contextmanager
def closed_lab(folder: Path) -> Iterator[ClosedLab]:
    with ExitStack() as stack:
        yield ClosedLab(folder, stack)


class HonestRobot:
    """What a robot's agent declares, and all that reaches it."""

    def __init__(self, session: Session, name: str) -> None:
        self.session, self.name = session, name
        self.heard: list[str] = []
        session.subscribe(KEYS.robot(name, "state"), self._on_put, max_bytes=1000)
        for key in (KEYS.robot(name, "**/stop"), *KEYS.every_stop):
            session.subscribe(key, self._on_put, max_bytes=1000)
        session.serve(KEYS.robot(name, "**"), self._on_request)
        self.states = session.state_publisher(KEYS.robot(name, "state"))
        self.telemetry = session.telemetry_publisher(KEYS.robot(name, "telemetry/motion"))
        session.watch_alive(KEYS.every_orchestrator_alive, lambda key, alive: None)
        session.declare_alive(KEYS.robot(name, "alive"))

    def _on_put(self, key: str, payload: bytes) -> None:
        self.heard.append(f"{key} {payload.decode()}")

    def _on_request(self, request: Request) -> None:
        self.heard.append(f"{request.key} {request.payload.decode()}")
        request.answer(f"{self.name} answers".encode())


def settle(*links: Session) -> None:
    """Return when what was sent over these links before has arrived where it ever will.

    The router handles the messages of a link in their order, so that its answer to a question on
    each link in turn comes after them; the callback of a receiver has a thread of its own.
    """
    for link in links:
        link.alive("nufleet/lab/robot/*/alive", timeout_s=PATIENCE_S)
    time.sleep(0.03)
