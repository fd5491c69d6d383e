"""What a closed fleet costs: connections, requests, stops and iterations, beside an open one.

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
from functools import partial
from pathlib import Path

import numpy as np

from nufleet.orchestrator.authority.authority import Authority
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.robot_agent.agent import Agent
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.frame import new_order_id, stop_frame
from nufleet.shared.wire.identity import SCHEME, address_of
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client, open_configured_router, open_router
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

KEYS = FleetKeys("lab")
PATIENCE_S = 60.0
STOPS_PER_ROUND = 10
"""The slowest hundredth of stops is what the load of the machine does to them: it takes many to
tell two fleets apart."""
DESCRIPTION = b"d" * 3000
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)
"""A test of two seconds of robot time, which a simulation plays in a few milliseconds."""


@dataclass
class Side:
    """One fleet as its orchestrator sees it."""

    address: str
    orchestrator: Session
    heard: threading.Event
    fleet: Fleet
    robots: tuple[str, ...]
    times_ms: dict[str, list[float]] = field(default_factory=dict)

    def iterate(self, number: int, *, counts: bool) -> None:
        """Run one test on every robot, all at the same time, as an iteration of a ranking does."""
        ended = {robot: threading.Event() for robot in self.robots}
        failed: list[str] = []
        goals = GoalRunner(self.fleet)

        def over(robot: str, how: Ended) -> None:
            if how.result is None or how.result.outcome is not Outcome.COMPLETED:
                failed.append(f"{robot}: {how.error or how.result}")
            ended[robot].set()

        began_s = time.perf_counter()
        with goals.pursuing() as loop:
            for robot in self.robots:
                on_ended = partial(over, robot)
                loop.begin(goals.errand(robot, f"t{number}.{robot}", TEST, on_ended=on_ended))
            for done in ended.values():
                goals.wait_for(loop, done)
        if counts:
            self._took(f"test {len(self.robots)} robots at once", began_s)
        goals.acknowledge_all()
        if failed:
            raise AssertionError(f"tests failed at {self.address}: {', '.join(failed)}")

    def measure(self) -> None:
        """Open a session and ask a robot, once each."""
        began_s = time.perf_counter()
        with open_client(self.address, timeout_s=PATIENCE_S):
            self._took("open a session", began_s)
        began_s = time.perf_counter()
        described = KEYS.robot("r0", "describe")
        replies = self.orchestrator.ask_all(described, b"?", timeout_s=PATIENCE_S)
        self._took("ask a robot for 3 kB", began_s)
        if replies != [DESCRIPTION]:
            raise AssertionError(f"a request at {self.address} had {len(replies)} answers")

    def stop(self) -> None:
        """Stop a robot once."""
        self.heard.clear()
        began_s = time.perf_counter()
        order = stop_frame("desk.x", "-", order_id=new_order_id())
        self.orchestrator.put_urgent(KEYS.command("r0", "desk", "stop"), order)
        if not self.heard.wait(PATIENCE_S):
            raise AssertionError(f"a stop at {self.address} was not heard")
        self._took("stop a robot", began_s)

    def _took(self, what: str, began_s: float) -> None:
        self.times_ms.setdefault(what, []).append(1000 * (time.perf_counter() - began_s))


@contextmanager
def side(address: str, robots: dict[str, str]) -> Iterator[Side]:
    """Join robots and an orchestrator at a router.

    The robot r0 only answers and hears stops; the others are double integrators with their agents.
    """
    heard, complete = threading.Event(), threading.Event()
    there: set[str] = set()

    def appeared(token: str, _alive: bool) -> None:
        there.add(token)
        if len(there) == len(robots):
            complete.set()

    tested = tuple(name for name in robots if name != "r0")
    with ExitStack() as opened:
        orchestrator = opened.enter_context(open_client(address, timeout_s=PATIENCE_S))
        orchestrator.watch_alive(KEYS.every_robot("alive"), appeared)
        robot = opened.enter_context(open_client(robots["r0"], timeout_s=PATIENCE_S))
        robot.serve(KEYS.robot("r0", "**"), lambda request: request.answer(DESCRIPTION))
        key = KEYS.robot("r0", "**/stop")
        robot.subscribe(key, lambda _key, _payload: heard.set(), max_bytes=1000)
        # Last: where its token has arrived, what was declared before it has arrived too.
        robot.declare_alive(KEYS.robot("r0", "alive"))
        for place, name in enumerate(tested):
            session = opened.enter_context(open_client(robots[name], timeout_s=PATIENCE_S))
            settings = DoubleIntegratorSettings(alpha=0.9, beta=0.003, noise_std_m=0.001)
            # No two robots measure the same, since what was learned from equal samples is kept.
            rng = np.random.default_rng([place, address.startswith(SCHEME)])
            moving = DoubleIntegrator(settings, rng)
            opened.enter_context(Agent(session, KEYS, name, moving, realtime=None))
        if not complete.wait(PATIENCE_S):
            raise AssertionError(f"{len(there)} of {len(robots)} robots appeared at {address}")
        fleet = Fleet(orchestrator, KEYS, new_orchestrator_id(orchestrator.principal))
        fleet.wait_for(tested, timeout_s=PATIENCE_S)
        yield Side(address, orchestrator, heard, fleet, tested)


@contextmanager
def closed_fleet(folder: Path, port: int, robots: int) -> Iterator[tuple[str, dict[str, str]]]:
    """Run the router of a closed fleet; yield the address of desk and those of the robots."""
    names = [f"r{k}" for k in range(robots + 1)]
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
    parser.add_argument("--iterations", type=int, default=30)
    parser.add_argument("--robots", type=int, default=32, help="robots that an iteration tests")
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
                for _ in range(STOPS_PER_ROUND):
                    opened.stop()
                    closed.stop()
            # The first iteration also loads the compiled numerics.
            for number in range(1 + options.iterations):
                for fleet in (opened, closed):
                    fleet.iterate(number, counts=number > 0)
        print(f"{options.robots} robots, {options.rounds} rounds, {options.iterations} iterations;")
        print("open, closed (ms), and their ratio")
        for what, times_ms in opened.times_ms.items():
            for label, percent in (("median", 50.0), ("p99", 99.0)):
                one = float(np.percentile(times_ms, percent))
                other = float(np.percentile(closed.times_ms[what], percent))
                print(f"{what:26} {label:7} {one:8.2f} {other:8.2f}   × {other / one:.2f}")


if __name__ == "__main__":
    main()
