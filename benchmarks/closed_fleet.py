"""What a closed fleet costs: connections, requests and stops, beside an open one in the same run.

    python -m benchmarks.closed_fleet --rounds 1000

Both routers, all robots and both orchestrators run in this process, and each round asks the open
and the closed fleet in turn, so that the load of the machine meets both.
"""

from __future__ import annotations

import argparse
import tempfile
import threading
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from nufleet.orchestrator.authority.authority import Authority
from nufleet.shared.wire.frame import stop_frame
from nufleet.shared.wire.identity import address_of
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.transport import Session, open_client, open_configured_router, open_router

KEYS = FleetKeys("lab")
PATIENCE_S = 60.0
DESCRIPTION = b"d" * 3000


@dataclass
class Side:
    """One fleet as its orchestrator sees it."""

    address: str
    orchestrator: Session
    heard: threading.Event
    times_ms: dict[str, list[float]] = field(default_factory=dict)

    def measure(self) -> None:
        """Open a session, ask a robot, and stop it, once each."""
        began_s = time.perf_counter()
        with open_client(self.address, timeout_s=PATIENCE_S):
            self._took("open a session", began_s)
        began_s = time.perf_counter()
        described = KEYS.robot("r0", "describe")
        replies = self.orchestrator.ask_all(described, b"?", timeout_s=PATIENCE_S)
        self._took("ask a robot for 3 kB", began_s)
        if replies != [DESCRIPTION]:
            raise AssertionError(f"a request at {self.address} had {len(replies)} answers")
        self.heard.clear()
        began_s = time.perf_counter()
        self.orchestrator.put_urgent(KEYS.command("r0", "desk", "stop"), stop_frame("desk.x", "-"))
        if not self.heard.wait(PATIENCE_S):
            raise AssertionError(f"a stop at {self.address} was not heard")
        self._took("stop a robot", began_s)

    def _took(self, what: str, began_s: float) -> None:
        self.times_ms.setdefault(what, []).append(1000 * (time.perf_counter() - began_s))


@contextmanager
def side(address: str, robots: dict[str, str]) -> Iterator[Side]:
    """Join robots and an orchestrator at a router; the first robot answers and hears stops."""
    heard, complete = threading.Event(), threading.Event()
    there: set[str] = set()

    def appeared(token: str, _alive: bool) -> None:
        there.add(token)
        if len(there) == len(robots):
            complete.set()

    with ExitStack() as sessions:
        orchestrator = sessions.enter_context(open_client(address, timeout_s=PATIENCE_S))
        orchestrator.watch_alive(KEYS.every_robot("alive"), appeared)
        for name, at in robots.items():
            robot = sessions.enter_context(open_client(at, timeout_s=PATIENCE_S))
            robot.serve(KEYS.robot(name, "**"), lambda request: request.answer(DESCRIPTION))
            key = KEYS.robot(name, "**/stop")
            robot.subscribe(key, lambda _key, _payload: heard.set(), max_bytes=1000)
            # Last: where its token has arrived, what was declared before it has arrived too.
            robot.declare_alive(KEYS.robot(name, "alive"))
        if not complete.wait(PATIENCE_S):
            raise AssertionError(f"{len(there)} of {len(robots)} robots appeared at {address}")
        yield Side(address, orchestrator, heard)


@contextmanager
def closed_fleet(folder: Path, port: int, robots: int) -> Iterator[tuple[str, dict[str, str]]]:
    """Run the router of a closed fleet; yield the address of desk and those of the robots."""
    names = [f"r{k}" for k in range(robots)]
    listed = "".join(f'[robots.{name}]\ndriver = "double_integrator"\n' for name in names)
    router = f'[router]\naddresses = ["127.0.0.1"]\nlisten = "127.0.0.1"\nport = {port}\n'
    inventory = folder / "lab.toml"
    inventory.write_text(f'schema = 1\nname = "lab"\n{router}[orchestrators.desk]\n{listed}')
    authority = Authority.create(inventory, folder / "lab.authority")
    found = {n: address_of(authority.enroll(n, folder / "ids").identity) for n in [*names, "desk"]}
    with open_configured_router(authority.configuration, allow_open=False):
        desk = found.pop("desk")
        yield desk, found


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=1000)
    parser.add_argument("--robots", type=int, default=32)
    parser.add_argument("--port", type=int, default=7467, help="port of the closed fleet's router")
    options = parser.parse_args(arguments)
    with (
        tempfile.TemporaryDirectory() as folder,
        open_router(["tcp/127.0.0.1:0"]) as router,
        closed_fleet(Path(folder), options.port, options.robots) as (desk, identities),
    ):
        plain = router.listening_on()[0]
        with (
            side(plain, dict.fromkeys(identities, plain)) as opened,
            side(desk, identities) as closed,
        ):
            for _ in range(options.rounds):
                opened.measure()
                closed.measure()
        what = f"{options.robots} robots, {options.rounds} rounds"
        print(f"{what}; open, closed (ms), and their ratio")
        for what, times_ms in opened.times_ms.items():
            for label, percent in (("median", 50.0), ("p99", 99.0)):
                one = float(np.percentile(times_ms, percent))
                other = float(np.percentile(closed.times_ms[what], percent))
                print(f"{what:22} {label:7} {one:8.2f} {other:8.2f}   × {other / one:.2f}")


if __name__ == "__main__":
    main()
