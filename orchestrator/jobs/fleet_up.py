"""Keeps a simulated fleet up and shows it until it is interrupted."""

from __future__ import annotations

import time
from pathlib import Path

from rich.live import Live

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.connection import CONNECT_TIMEOUT_S, wait_for_robots
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.orchestrator.fleet.processes import FleetProcesses, grouped
from nufleet.orchestrator.fleet.table import fleet_table
from nufleet.orchestrator.runs.console import stderr_console
from nufleet.shared.errors import NufleetError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.robots.drivers import check_settings
from nufleet.shared.robots.fleet_file import read_fleet_file
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.transport import open_client

AGENT_PROCESSES = 2
"""Robots are dealt to this many processes unless each is to have its own."""


def fleet_up(path: Path, *, listen: str, processes: bool, realtime: float | None) -> None:
    """Run a router and a file's robots until Ctrl-C, with a live table when on a terminal.

    Raises:
        FleetFileError: the file is not right.
        EndpointInUseError: the router cannot listen there.
        NufleetError: a process of the fleet ended by itself.
    """
    file = read_fleet_file(path)
    check_settings(file, path)
    console = stderr_console()
    robots = tuple(file.robots)
    groups = grouped(file, processes=len(robots) if processes else AGENT_PROCESSES)
    with FleetProcesses() as started:
        started.start_router(listen)
        started.start_agents(path, groups, listen, realtime)
        with open_client(listen, timeout_s=CONNECT_TIMEOUT_S) as session:
            fleet = Fleet(session, FleetKeys(file.name), new_orchestrator_id())
            wait_for_robots(fleet, started, file)
            shown = without_secrets(listen)
            console.print(
                f"{len(robots)} robots of fleet {file.name} are up at {shown}; "
                f"rank them with: nufleet rank --connect {shown}   (Ctrl-C ends them)"
            )
            watches = [fleet.watch(robot) for robot in robots]
            with Live(console=console, auto_refresh=False, transient=True) as live:
                while not (dead := started.dead()):
                    if console.is_terminal:
                        live.update(fleet_table(file.name, watches), refresh=True)
                    time.sleep(0.25)
        raise NufleetError("; ".join(dead))
