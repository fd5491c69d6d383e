"""Opens what a flying command needs in addition: pilot, table of flights and their drawing."""

from __future__ import annotations

import secrets
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from nufleet.orchestrator.flights.pilot import PathFlight, Pilot
from nufleet.orchestrator.flights.table import FlightTable
from nufleet.orchestrator.jobs.consent import Moves
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.viewer.flight_feed import PathView
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description


class FlyingRun(Opening):
    """An `Opening` whose last step, `fly`, opens everything that flights need."""

    pilot: Pilot
    """Pilot that has the robots fly; exists after `fly`."""
    view: PathView
    """Observer that draws flights along paths; exists after `fly`."""
    table: FlightTable
    """Table of all samples of these flights; exists after `fly`."""

    def fly(
        self, kind: str, descriptions: Mapping[str, Description], moves: Moves, *, live: bool
    ) -> None:
        """Create the run's folder, unless it was kept before, and open what flights need.

        When the command fails or is interrupted afterwards, all flying robots are brought to rest
        first.

        Args:
            kind: Kind of the run, the last part of its folder's name.
            descriptions: Descriptions of the robots that will fly, by robot.
            moves: What they are going to do.
            live: Whether to serve the recording to live viewers.

        Raises:
            InvalidInputError, OnlyPlannedError, LeaseHeldError, RobotOwnedError: See `take`.
        """
        if not hasattr(self, "folder"):
            self.keep(kind)
        self.take(descriptions, moves)
        self._open(self.folder.study_id, live=live)

    def fly_on(
        self, path: Path, descriptions: Mapping[str, Description], moves: Moves, *, live: bool
    ) -> None:
        """Open the folder of an interrupted run, and what flights need, like `fly`.

        Its recording begins with the flights that follow.

        Args:
            path: Folder of the run.
            descriptions: Descriptions of the robots that will fly, by robot.
            moves: What they are going to do.
            live: Whether to serve the recording to live viewers.

        Raises:
            InvalidInputError, OnlyPlannedError, LeaseHeldError, RobotOwnedError: See `go_on`.
        """
        self.go_on(path, descriptions, moves)
        # No goal may have the id of an earlier one.
        self._open(f"{self.folder.study_id}.{secrets.token_hex(4)}", live=live)

    def _open(self, goals: str, *, live: bool) -> None:
        fleet = self.connection.fleet
        self.record(live=live)
        self.view = PathView(self.clock, self.writer.emit)
        self.view.watch(fleet)
        self.table = FlightTable(self.folder.path)
        self.pilot = Pilot(fleet, goals)
        self.guard(self.pilot.interrupt)
        self._stack.enter_context(_brought_to_rest(self.pilot))


@contextmanager
def _brought_to_rest(pilot: Pilot) -> Iterator[None]:
    try:
        yield
    except BaseException:
        pilot.interrupt()
        raise
    pilot.acknowledge_all()


class KeptFlights:
    """An observer that draws each flight, stores it, and prints its error in one line."""

    def __init__(self, run: FlyingRun) -> None:
        self._run = run
        self._axes: tuple[str, ...] = ()
        self._unit = "m"

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """Begin to draw a flight."""
        self._axes = tuple(axis.name for axis in spec.axes)
        self._unit = spec.axes[0].unit
        self._run.view.begins(robot, label, spec)

    def ended(self, flight: PathFlight) -> None:
        """Store the flight and print its error."""
        self._run.view.ended(flight)
        self._run.table.write(flight, self._axes)
        self._run.results.print(f"  {flight.label:<34} {error_text(flight, self._unit)}")


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
