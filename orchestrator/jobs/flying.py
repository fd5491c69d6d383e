"""How commands that fly reach and take their robots, and keep and show what these do."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass

from rich.console import Console

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.fleet.connection import Connection
from nufleet.orchestrator.fleet.reach import Reach
from nufleet.orchestrator.flights.pilot import PathFlight, Pilot
from nufleet.orchestrator.flights.table import FlightTable
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.runs.folder import RunFolder, make_runs_root
from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.flight_feed import PathView
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT, WEB_PORT
from nufleet.orchestrator.viewer.writer import RerunWriter, ServeOptions
from nufleet.shared.command_line import invocation
from nufleet.shared.robots.spec import RobotSpec


@dataclass(frozen=True)
class OpenRun:
    """A fleet that is reached, and where what it flies is kept and shown."""

    connection: Connection
    folder: RunFolder
    writer: RerunWriter
    pilot: Pilot
    archive: Archive
    view: PathView
    table: FlightTable
    clock: ViewerClock
    console: Console


@contextmanager
def flying(
    reach: Reach,
    kind: str,
    storage: Storage,
    console: Console,
    *,
    live: bool,
    robots: Callable[[tuple[str, ...]], tuple[str, ...]],
) -> Iterator[OpenRun]:
    """Reach a fleet, take robots, and open a run's folder, its recording and table of flights.

    When it is left early, all robots that fly are brought to rest first.

    Args:
        reach: the fleet.
        kind: of the run.
        storage: where it is kept.
        console: what is told.
        live: whether to serve the recording.
        robots: returns, of the robots that are there, those that will fly.

    Raises:
        LeaseHeldError: one of them belongs to another orchestrator.
        LeaseLostError: another orchestrator has taken one over.
    """
    make_runs_root(storage.runs_root)
    with ExitStack() as stack:
        repository = stack.enter_context(storage.open())
        connection = stack.enter_context(reach.connection(console))
        chosen = robots(connection.robots)
        check_robots(chosen, connection.robots)
        folder = stack.enter_context(RunFolder(storage.runs_root, f"{connection.name}-{kind}"))
        leases = stack.enter_context(
            lease_robots(
                repository.leases,
                connection.fleet,
                reach.lease_scope(connection.name, folder.study_id),
                chosen,
            )
        )
        archive = Archive(repository, connection.name, leases)
        serve = ServeOptions(grpc_port=GRPC_PORT, web_port=WEB_PORT) if live else None
        writer = stack.enter_context(
            RerunWriter(folder.path.name, recording=folder.recording, serve=serve)
        )
        if live:
            console.print(f"live: `nufleet view --live`, or {writer.web_url} in a browser")
        clock = ViewerClock(time.monotonic)
        view = PathView(clock, writer.emit)
        view.watch(connection.fleet)
        table = stack.enter_context(FlightTable(folder.path))
        pilot = Pilot(connection.fleet, folder.study_id)
        stack.enter_context(leases.guarding(pilot.interrupt))
        try:
            yield OpenRun(connection, folder, writer, pilot, archive, view, table, clock, console)
        except BaseException:
            pilot.interrupt()
            raise
        pilot.acknowledge_all()
    if writer.dropped:
        console.print(f"[yellow]the recording and its viewers missed {writer.dropped} events[/]")
    console.print(f"open the recording with:  {invocation()} view {folder.path}")


class KeptFlights:
    """Shows each flight, stores it, and says in one line how it went."""

    def __init__(self, session: OpenRun) -> None:
        self._session = session
        self._axes: tuple[str, ...] = ()
        self._unit = "m"

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """Begin to draw it."""
        self._axes = tuple(axis.name for axis in spec.axes)
        self._unit = spec.axes[0].unit
        self._session.view.begins(robot, label, spec)

    def ended(self, flight: PathFlight) -> None:
        """Store it and print its error."""
        session = self._session
        session.view.ended(flight)
        session.table.write(flight, self._axes)
        session.console.print(f"  {flight.label:<34} {error_text(flight, self._unit)}")


def error_text(flight: PathFlight, unit: str) -> str:
    """Return in a few words how a flight went."""
    if flight.failure is not None:
        return f"[red]failed: {flight.failure}[/]"
    text = f"RMS error {1000 * flight.rms_error:6.1f} m{unit}"
    event = flight.details.taken_back
    if event is not None:
        when_s = event.sample * flight.sample_time_s
        text += f"  [yellow]prior taken back at {when_s:.1f} s: {event.reason}[/]"
    return text
