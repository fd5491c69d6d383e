"""Connects a command to a fleet: a running one through its router, or one started for it alone."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import NamedTuple

from nufleet.orchestrator.fleet.capacity import Machine, check_room
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.discovery import robots_at
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.orchestrator.fleet.processes import FleetProcesses, grouped, private_folder
from nufleet.shared.errors import InvalidInputError, NufleetError, RobotLostError
from nufleet.shared.redaction import without_secrets
from nufleet.shared.robots.drivers import check_settings
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client

CONNECT_TIMEOUT_S = 5.0
START_TIMEOUT_S = 60.0
"""Time in s to wait for the next robot of a fleet that is started."""

_SHOWN = 8
"""Number of missing robots that an error names."""


class Connection(NamedTuple):
    """A fleet that is connected."""

    fleet: Fleet
    """Client of the fleet."""
    name: str
    """Name of the fleet."""
    robots: tuple[str, ...]
    """Names of the robots that are alive."""


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
        endpoint: Endpoint at which the router listens.
        fleet_name: Name of the fleet; None takes the only one at the router.
        robots: Names of the robots that have to be alive.
        wait_s: Longest time to wait for router, fleet and robots to appear, in s.

    Yields:
        The connected fleet.

    Raises:
        NoRouterError: No router answers.
        InvalidInputError: There is no fleet, or there are several and none was named, or the
            identity belongs to another one.
        RobotLostError: A robot that has to be alive did not appear.
    """
    deadline_s = time.monotonic() + wait_s
    with open_client(endpoint, timeout_s=max(CONNECT_TIMEOUT_S, wait_s)) as session:
        session.check_admitted()
        fleet_name = fleet_at(session, fleet_name)
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
        fleet = Fleet(session, FleetKeys(fleet_name), new_orchestrator_id(session.principal))
        if wait_s > 0:
            fleet.wait_for(robots, timeout_s=max(0.0, deadline_s - time.monotonic()))
        yield Connection(fleet, fleet_name, fleet.robots())


def fleet_at(session: Session, named: str | None) -> str | None:
    """Return the name of the fleet that a command is for: that of the identity, or the one named.

    Args:
        session: Session to the fleet's router.
        named: Name that the user gave; None for none.

    Raises:
        InvalidInputError: The identity belongs to another fleet than the one named.
    """
    identity = session.identity
    if identity is None:
        return named
    if named not in (None, identity.fleet):
        raise InvalidInputError(
            f"the identity {identity.path} belongs to fleet {identity.fleet}, not to {named}"
        )
    return identity.fleet


@contextmanager
def started_fleet(
    file: FleetFile,
    path: Path,
    *,
    processes: int | None = None,
    realtime: float | None = None,
    state_folder: Path | None = None,
    appeared: Callable[[int, int], None] = lambda there, of: None,
) -> Iterator[Connection]:
    """Start the fleet of a file with a router of its own, and end both afterwards.

    Args:
        file: Content of the fleet file.
        path: Path of the fleet file, which the robots' processes read.
        processes: Number of processes that share the robots; None gives each robot its own.
        realtime: Multiple of real time at which simulated robots play; None plays as fast as
            possible.
        state_folder: Folder in which the robots keep what they learn, and find what they learned
            before; None if they begin with nothing, and leave nothing.
        appeared: Callback that receives how many robots are there, and of how many.

    Yields:
        The connected fleet, with all robots of the file alive.

    Raises:
        InvalidInputError: The fleet has more robots than fit this machine.
    """
    check_settings(file, path)
    check_room(len(file.robots), processes=processes, machine=Machine.this())
    groups = grouped(file, processes=processes or len(file.robots))
    with private_folder() as folder, FleetProcesses() as started:
        endpoint = f"unixsock-stream/{folder}/router.sock"
        started.start_router(endpoint)
        kept = state_folder or Path(folder, "state")
        started.start_agents(path, groups, endpoint, realtime, state_folder=kept)
        with open_client(endpoint, timeout_s=CONNECT_TIMEOUT_S) as session:
            fleet = Fleet(session, FleetKeys(file.name), new_orchestrator_id())
            wait_for_robots(fleet, started, file, appeared)
            yield Connection(fleet, file.name, tuple(file.robots))


def wait_for_robots(
    fleet: Fleet,
    started: FleetProcesses,
    file: FleetFile,
    appeared: Callable[[int, int], None] = lambda there, of: None,
) -> None:
    """Wait until all robots of a file are alive; raise at once when one of their processes died.

    A large fleet takes minutes on a small machine, so the time counts from the last robot that
    appeared.

    Raises:
        RobotLostError: No further robot appeared for `START_TIMEOUT_S`.
        NufleetError: A process ended.
    """
    waited_s = 0.0
    missing = tuple(file.robots)
    while missing:
        appeared(len(file.robots) - len(missing), len(file.robots))
        dead = started.dead()
        if dead:
            raise NufleetError("; ".join(dead))
        try:
            fleet.wait_for(missing, timeout_s=0.5)
        except RobotLostError as error:
            waited_s += 0.5
            if waited_s >= START_TIMEOUT_S:
                more = len(missing) - _SHOWN
                shown = ", ".join(missing[:_SHOWN]) + (f" and {more} more" if more > 0 else "")
                raise RobotLostError(
                    f"robots {shown} did not start: for {START_TIMEOUT_S:g} s no further robot "
                    "appeared, although their processes run. A busy machine may need longer, so "
                    "try again"
                ) from error
        before = len(missing)
        missing = tuple(robot for robot in missing if not fleet.watch(robot).alive)
        if len(missing) < before:
            waited_s = 0.0
    appeared(len(file.robots), len(file.robots))
