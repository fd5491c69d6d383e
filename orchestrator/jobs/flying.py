"""Opens all that a flying command needs: fleet, leases, run folder, recording and pilot."""

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
    """A connected fleet with leased robots, and the places that store and show its flights."""

    connection: Connection
    """Connection to the fleet."""
    folder: RunFolder
    """Folder of the run."""
    writer: RerunWriter
    """Writer of the recording and of the live view."""
    pilot: Pilot
    """Pilot that has the robots fly."""
    archive: Archive
    """Repository that stores studies, with the leases on the robots."""
    view: PathView
    """Observer that draws flights along paths."""
    table: FlightTable
    """Table of all samples of these flights."""
    clock: ViewerClock
    """Time axis of the recording."""
    console: Console
    """Console for progress, on stderr."""


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
    """Connect to a fleet, lease robots, and open a run's folder, recording and table of flights.

    When the body fails or is interrupted, all flying robots are brought to rest first.

    Args:
        reach: Way to connect to the fleet.
        kind: Kind of the run, the last part of its folder's name.
        storage: Places where the run is stored.
        console: Console for progress.
        live: Whether to serve the recording to live viewers.
        robots: Function that selects the robots that will fly from the names of those present.

    Yields:
        Everything that was opened; leaving the context closes it.

    Raises:
        LeaseHeldError: A robot belongs to another orchestrator.
        LeaseLostError: Another orchestrator has taken a robot over.
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
    """An observer that draws each flight, stores it, and prints its error in one line."""

    def __init__(self, session: OpenRun) -> None:
        self._session = session
        self._axes: tuple[str, ...] = ()
        self._unit = "m"

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """Begin to draw a flight."""
        self._axes = tuple(axis.name for axis in spec.axes)
        self._unit = spec.axes[0].unit
        self._session.view.begins(robot, label, spec)

    def ended(self, flight: PathFlight) -> None:
        """Store the flight and print its error."""
        session = self._session
        session.view.ended(flight)
        session.table.write(flight, self._axes)
        session.console.print(f"  {flight.label:<34} {error_text(flight, self._unit)}")


def error_text(flight: PathFlight, unit: str) -> str:
    """Return the outcome of a flight in a few words, with its error in thousandths of `unit`."""
    if flight.failure is not None:
        return f"[red]failed: {flight.failure}[/]"
    text = f"RMS error {1000 * flight.rms_error:6.1f} m{unit}"
    event = flight.details.taken_back
    if event is not None:
        when_s = event.sample * flight.sample_time_s
        text += f"  [yellow]prior withdrawn at {when_s:.1f} s: {event.reason}[/]"
    return text
