"""How commands that fly reach their fleet, and keep and show what it does."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from orchestrator.connection import Connection, running_fleet, started_fleet
from orchestrator.flight_table import FlightTable
from orchestrator.path_view import PathView
from orchestrator.pilot import PathFlight, Pilot
from orchestrator.run_folder import RunFolder, make_runs_root
from orchestrator.study_clock import StudyClock
from orchestrator.viewer.ports import GRPC_PORT, WEB_PORT
from orchestrator.viewer.writer import RerunWriter, ServeOptions
from shared.command_line import invocation
from shared.fleet_file import FleetFile, read_fleet_file
from shared.robot_spec import RobotSpec


@dataclass(frozen=True)
class Reach:
    """Which fleet: one started from a file for this command alone, or a running one."""

    fleet_file: Path | None
    connect: str
    fleet_name: str | None
    realtime: float | None = None

    @property
    def file(self) -> FleetFile | None:
        """The fleet file, read; None for a running fleet."""
        return None if self.fleet_file is None else read_fleet_file(self.fleet_file)

    def connection(self, console: Console) -> AbstractContextManager[Connection]:
        """Start the fleet, or join it."""
        if self.fleet_file is None:
            return running_fleet(self.connect, self.fleet_name)
        robots = len(read_fleet_file(self.fleet_file).robots)
        console.print(f"starting a router and {robots} robots of {self.fleet_file}")
        return started_fleet(self.fleet_file, processes=2, realtime=self.realtime)


@dataclass(frozen=True)
class Session:
    """A fleet that is reached, and where what it flies is kept and shown."""

    connection: Connection
    folder: RunFolder
    writer: RerunWriter
    pilot: Pilot
    view: PathView
    table: FlightTable
    clock: StudyClock
    console: Console


@contextmanager
def flying(
    reach: Reach, kind: str, runs_root: Path, console: Console, *, live: bool
) -> Iterator[Session]:
    """Reach a fleet and open a run's folder, its recording and its table of flights.

    When it is left early, all robots that fly are brought to rest first.
    """
    make_runs_root(runs_root)
    with ExitStack() as stack:
        connection = stack.enter_context(reach.connection(console))
        folder = stack.enter_context(RunFolder(runs_root, f"{connection.name}-{kind}"))
        serve = ServeOptions(grpc_port=GRPC_PORT, web_port=WEB_PORT) if live else None
        writer = stack.enter_context(
            RerunWriter(folder.path.name, recording=folder.recording, serve=serve)
        )
        if live:
            console.print(f"live: `nufleet view --live`, or {writer.web_url} in a browser")
        clock = StudyClock(time.monotonic)
        view = PathView(clock, writer.emit)
        view.watch(connection.fleet)
        table = stack.enter_context(FlightTable(folder.path))
        pilot = Pilot(connection.fleet, folder.path.name.lower())
        try:
            yield Session(connection, folder, writer, pilot, view, table, clock, console)
        except BaseException:
            pilot.interrupt()
            raise
        pilot.acknowledge_all()
    if writer.dropped:
        console.print(f"[yellow]the recording and its viewers missed {writer.dropped} events[/]")
    console.print(f"open the recording with:  {invocation()} view {folder.path}")


class KeptFlights:
    """Shows each flight, stores it, and says in one line how it went."""

    def __init__(self, session: Session) -> None:
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
