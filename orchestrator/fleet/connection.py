"""How a command reaches a fleet: a running one through its router, or one started for it alone."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.discovery import robots_at
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.orchestrator.fleet.processes import FleetProcesses, grouped, private_folder
from nufleet.shared.errors import InvalidInputError, NufleetError, RobotLostError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.robots.drivers import check_settings
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.transport import open_client

CONNECT_TIMEOUT_S = 5.0
START_TIMEOUT_S = 60.0


class Connection(NamedTuple):
    """A fleet that can be reached, its name, and the robots that are there."""

    fleet: Fleet
    name: str
    robots: tuple[str, ...]


@contextmanager
def running_fleet(
    endpoint: str,
    fleet_name: str | None,
    *,
    robots: tuple[str, ...] = (),
    wait_s: float = 0.0,
) -> Iterator[Connection]:
    """Join the fleet at a router.

    Args:
        endpoint: where the router listens.
        fleet_name: which fleet; None takes the only one there is.
        robots: who is needed.
        wait_s: how long to wait for router, fleet and robots to appear.

    Raises:
        NoRouterError: no router answers.
        InvalidInputError: there is no fleet, or several and none was named.
        RobotLostError: a robot that was waited for did not appear.
    """
    deadline_s = time.monotonic() + wait_s
    with open_client(endpoint, timeout_s=max(CONNECT_TIMEOUT_S, wait_s)) as session:
        while fleet_name is None:
            found = sorted({fleet for fleet, _ in robots_at(session)})
            if len(found) == 1:
                fleet_name = found[0]
            elif found or time.monotonic() >= deadline_s:
                there = f"there are {', '.join(found)}" if found else "no robot is there"
                raise InvalidInputError(
                    f"which fleet at {without_secrets(endpoint)}? {there}; name one with "
                    "--fleet-name, or start robots with `nufleet fleet up FLEET` or `nufleet agent "
                    "FLEET`"
                )
            else:
                time.sleep(0.2)
        fleet = Fleet(session, FleetKeys(fleet_name), new_orchestrator_id())
        if wait_s > 0:
            fleet.wait_for(robots, timeout_s=max(0.0, deadline_s - time.monotonic()))
        yield Connection(fleet, fleet_name, fleet.robots())


@contextmanager
def started_fleet(
    path: Path, *, processes: int | None = None, realtime: float | None = None
) -> Iterator[Connection]:
    """Start the fleet of a file with a router of its own, and end it all afterwards.

    It remembers nothing of what it learned before.

    Args:
        path: the fleet file.
        processes: how many processes to deal the robots to; None gives each its own.
        realtime: at which multiple of real time simulated robots play; None as fast as they can.
    """
    file = read_fleet_file(path)
    check_settings(file, path)
    groups = grouped(file, processes=processes or len(file.robots))
    with private_folder() as folder, FleetProcesses() as started:
        endpoint = f"unixsock-stream/{folder}/router.sock"
        started.start_router(endpoint)
        started.start_agents(path, groups, endpoint, realtime, state_folder=folder / "state")
        with open_client(endpoint, timeout_s=CONNECT_TIMEOUT_S) as session:
            fleet = Fleet(session, FleetKeys(file.name), new_orchestrator_id())
            wait_for_robots(fleet, started, file)
            yield Connection(fleet, file.name, tuple(file.robots))


def wait_for_robots(fleet: Fleet, started: FleetProcesses, file: FleetFile) -> None:
    """Wait until all robots of a file are there; raise at once when a process of theirs died."""
    waited_s = 0.0
    missing = tuple(file.robots)
    while missing:
        dead = started.dead()
        if dead:
            raise NufleetError("; ".join(dead))
        try:
            fleet.wait_for(missing, timeout_s=0.5)
        except RobotLostError:
            waited_s += 0.5
            if waited_s >= START_TIMEOUT_S:
                raise
        missing = tuple(robot for robot in missing if not fleet.watch(robot).alive)
