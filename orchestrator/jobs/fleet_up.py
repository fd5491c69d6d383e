"""Runs a simulated fleet, and shows its state, until it is interrupted."""

from __future__ import annotations

import shlex
import time
from functools import partial
from pathlib import Path

from rich.live import Live

from nufleet.orchestrator.fleet.capacity import Machine, check_room
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.connection import CONNECT_TIMEOUT_S, wait_for_robots
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.orchestrator.fleet.processes import FleetProcesses, grouped
from nufleet.orchestrator.fleet.table import fleet_table
from nufleet.orchestrator.jobs.terminal import bars_shown, stderr_console
from nufleet.shared.command_line import invocation
from nufleet.shared.errors import NufleetError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.robots.drivers import check_settings
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.openness import LOCAL_ENDPOINT, check_closed
from nufleet.shared.wire.transport import open_client

AGENT_PROCESSES = 2
"""Number of processes that the robots are spread over, unless each robot gets one of its own."""


def fleet_up(
    fleet_file: Path,
    *,
    listen: str,
    processes: bool,
    realtime: float | None,
    allow_open: bool,
) -> None:
    """Run a router and the robots of a fleet file until Ctrl-C, with a live table on a terminal.

    Args:
        fleet_file: Path of the fleet file.
        listen: Endpoint on which the router listens.
        processes: Whether each robot gets a process of its own.
        realtime: Speed of the simulated robots relative to real time; None for as fast as possible.
        allow_open: Whether the router may listen where every machine could command the robots.

    Raises:
        FleetFileError: The file is not valid.
        InvalidInputError: The machine has no room for all robots of the file.
        EndpointInUseError: The router cannot listen on that endpoint.
        NufleetError: A process of the fleet ended by itself.
    """
    check_closed(listen, allow_open=allow_open, anonymous=True)
    file = read_fleet_file(fleet_file)
    check_settings(file, fleet_file)
    console = stderr_console()
    robots = tuple(file.robots)
    check_room(
        len(robots), processes=None if processes else AGENT_PROCESSES, machine=Machine.this()
    )
    groups = grouped(file, processes=len(robots) if processes else AGENT_PROCESSES)
    with FleetProcesses() as started:
        started.start_router(listen)
        started.start_agents(fleet_file, groups, listen, realtime)
        with open_client(listen, timeout_s=CONNECT_TIMEOUT_S) as session:
            fleet = Fleet(session, FleetKeys(file.name), new_orchestrator_id())
            with bars_shown(console, "robots") as bar:
                wait_for_robots(fleet, started, file, partial(bar, "starting"))
            shown = without_secrets(listen)
            console.print(
                f"{len(robots)} robots of fleet {file.name} are up at {shown} (Ctrl-C ends them)\n"
                f"rank them with:  {_ranking(file, listen)}"
            )
            watches = [fleet.watch(robot) for robot in robots]
            with Live(console=console, auto_refresh=False, transient=True) as live:
                while not (dead := started.dead()):
                    if console.is_terminal:
                        live.update(fleet_table(file.name, watches), refresh=True)
                    time.sleep(0.25)
        raise NufleetError("; ".join(dead))


def _ranking(file: FleetFile, endpoint: str) -> str:
    """Return a command that ranks a fleet in another terminal, for its own target and band."""
    target = file.study.target if file.study is not None else next(iter(file.robots))
    words = ["rank", "--target", target]
    if file.study is not None and file.study.band_rad_s is not None:
        words += ["--band", *(f"{omega:g}" for omega in file.study.band_rad_s)]
    if endpoint != LOCAL_ENDPOINT:
        words += ["--connect", without_secrets(endpoint)]
    return f"{invocation()} {shlex.join(words)}"
