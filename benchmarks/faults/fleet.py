"""Fleets of simulated robots as processes, for measuring what becomes of them."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from orchestrator.fleet import Fleet
from orchestrator.fleet_processes import FleetProcesses
from shared.keys import FleetKeys
from shared.transport import Session, open_client

START_TIMEOUT_S = 60.0


class Running(NamedTuple):
    """A fleet as an orchestrator sees it, and the processes that it consists of."""

    fleet: Fleet
    session: Session
    keys: FleetKeys
    started: FleetProcesses


def write_fleet(path: Path, robots: int) -> tuple[str, ...]:
    """Write a fleet of Section V robots, each a little different; return their names."""
    names = tuple(f"robot-{k}" for k in range(robots))
    lines = ["schema = 1", 'name = "faults"', ""]
    for k, name in enumerate(names):
        lines += [
            f"[robots.{name}]",
            'driver = "double_integrator"',
            f"settings = {{ alpha = {0.85 + 0.01 * k:.3f}, beta = 0.003, noise_std_m = 0.001 }}",
            "",
        ]
    path.write_text("\n".join(lines))
    return names


@contextmanager
def running_processes(
    *, robots: int, processes: int | None = None, realtime: float | None = None
) -> Iterator[Running]:
    """Start a router and agents, one process each unless told how many; end them all afterwards."""
    with (
        tempfile.TemporaryDirectory(prefix="nufleet-faults-") as folder,
        FleetProcesses() as started,
    ):
        path, endpoint = Path(folder) / "fleet.toml", f"unixsock-stream/{folder}/r.sock"
        names = write_fleet(path, robots)
        count = processes or robots
        groups = [names[start::count] for start in range(count)]
        started.start_router(endpoint)
        started.start_agents(path, groups, endpoint, realtime, state_folder=Path(folder) / "state")
        keys = FleetKeys("faults")
        with open_client(endpoint, timeout_s=START_TIMEOUT_S) as session:
            fleet = Fleet(session, keys, "orchestrator-of-faults")
            fleet.wait_for(names, timeout_s=START_TIMEOUT_S)
            yield Running(fleet, session, keys, started)
