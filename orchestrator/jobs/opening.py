"""Opens what a command works with, one step after the other, and closes it in reverse order."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from typing import Any, Self

from rich.console import Console

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.fleet.connection import Connection
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.jobs.commands import StoredCommand
from nufleet.orchestrator.jobs.consent import Moves, agree
from nufleet.orchestrator.jobs.motions_shown import motions_shown
from nufleet.orchestrator.jobs.rest_report import say_who_rests
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import bars_shown, results_console
from nufleet.orchestrator.repository.errors import LeaseHeldError
from nufleet.orchestrator.repository.repository import Repository
from nufleet.orchestrator.runs.folder import RunFolder, make_runs_root, study_id_of
from nufleet.orchestrator.runs.headline import Headline, write_headline
from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT, WEB_PORT
from nufleet.orchestrator.viewer.writer import RerunWriter, ServeOptions
from nufleet.shared.command_line import invocation
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.wire.messages import Description


class Opening:
    """A context manager that holds open what a command works with.

    Entering it opens the repository. The command then takes the steps that it needs, in this order:
    `reach` connects to the fleet; `keep` creates the folder of a new run; `take` leases robots, or
    `go_on` those of an interrupted run together with its folder; `record` opens the recording. An
    attribute exists from the step on that its description names.
    """

    storage: Storage
    """Places where the command stores its run."""
    console: Console
    """Console for progress; one that is quiet prints nothing."""
    results: Console
    """Console for what the command was asked for."""
    repository: Repository
    """Repository; exists inside the context."""
    choice: FleetChoice
    """The fleet that was chosen; exists after `reach`."""
    connection: Connection
    """Connection to the fleet; exists after `reach`."""
    folder: RunFolder
    """Folder of the run; exists after `keep` or `go_on`."""
    archive: Archive
    """Storage for studies, with the leases on the robots; exists after `take` or `go_on`."""
    writer: RerunWriter
    """Writer of the recording and of the live view; exists after `record`."""
    draws: bool
    """Whether the run draws a recording and plots; exists after `record`."""
    clock: ViewerClock
    """Time axis of the recording; exists after `record`."""

    def __init__(self, command: StoredCommand, console: Console) -> None:
        self._command = command
        self.storage = command.storage
        self.console = console
        self.results = results_console(console, as_json=command.as_json)
        self._stack = ExitStack()
        self._run_id = ""

    def __enter__(self) -> Self:
        make_runs_root(self.storage.runs_root)
        self.repository = self._stack.enter_context(self.storage.open())
        return self

    def __exit__(self, *error: Any) -> None:
        self._stack.__exit__(*error)
        if error[0] is None and self._run_id:
            # All files of the run are complete only now.
            from nufleet.orchestrator.history.report_page import leave_report

            page = leave_report(self.folder.path)
            if page is not None:
                self.console.print(f"report to hand on:  {page}")

    def reach(
        self, choice: FleetChoice, robots: tuple[str, ...] = (), *, wait_s: float = 0.0
    ) -> Connection:
        """Start the chosen fleet, or join it if it is running.

        Args:
            choice: Fleet to start or to join.
            robots: Names of the robots that have to be alive in a running fleet.
            wait_s: Longest time to wait for a running fleet and those robots, in s.

        Raises:
            NoRouterError, InvalidInputError, RobotLostError: See `running_fleet`.
            NufleetError: The fleet cannot be started.
        """
        with bars_shown(self.console, "robots") as shown:
            appeared = partial(shown, "starting")
            opened = choice.connection(self.console, robots, wait_s=wait_s, appeared=appeared)
            self.connection = self._stack.enter_context(opened)
        self.choice = choice
        return self.connection

    def keep(self, kind: str | None = None, fleet: str | None = None) -> RunFolder:
        """Create the folder of a new run.

        It is deleted again if an error ends the command before `configure` was called.

        Args:
            kind: Last part of the folder's name, after that of the fleet; None for no such part.
            fleet: Name of the fleet, for a run that needs its folder before it reaches the fleet;
                None for that of the connected one.
        """
        fleet = fleet or self.connection.name
        name = fleet if kind is None else f"{fleet}-{kind}"
        self.folder = self._stack.enter_context(RunFolder(self.storage.runs_root, name))
        self._run_id = self.folder.study_id
        return self.folder

    def configure(self, request: Mapping[str, Any]) -> None:
        """Write the request to the run's folder, with the fleet and the places of storage.

        Args:
            request: All settings of the command; the repository's address in it is replaced by one
                without a password.
        """
        self.folder.write_configuration(
            {**request, "fleet": self.connection.name, **self.storage.document()}
        )
        # Without it, a list of runs would look for a run that did not end in the repository.
        write_headline(self.folder.path, Headline())

    def take(self, descriptions: Mapping[str, Description], moves: Moves) -> Archive:
        """Lease robots, so that this command alone moves them, if it may move them at all.

        Args:
            descriptions: Descriptions of these robots, by robot, as they were just received.
            moves: What they are going to do; None if they will not move.

        Raises:
            InvalidInputError, OnlyPlannedError, click.Abort: They may not move; see `agree`.
            LeaseHeldError: Another orchestrator holds one of them.
            RobotOwnedError: An orchestrator with another repository commands one of them.
        """
        return self._lease(descriptions, moves, self._run_id, patient=False)

    def go_on(self, path: Path, descriptions: Mapping[str, Description], moves: Moves) -> RunFolder:
        """Lease the robots of an interrupted run, and open its folder again.

        An owner that no longer renews its leases is waited for until they have run out. The folder
        is not touched before, since that owner may be alive and still writing to it.

        Args:
            path: Folder of the run.
            descriptions: Descriptions of these robots, by robot, as they were just received.
            moves: What they are going to do.

        Raises:
            InvalidInputError, OnlyPlannedError, click.Abort: See `take`.
            LeaseHeldError, RobotOwnedError: See `take`; a holder that is alive is not waited for.
        """
        self._lease(descriptions, moves, study_id_of(path), patient=True)
        again = RunFolder(path.parent, path.name, goes_on=True)
        self.folder = self._stack.enter_context(again)
        self._run_id = again.study_id
        return self.folder

    def record(self, *, live: bool, draws: bool = True) -> RerunWriter:
        """Open the recording; closing it prints how to look at it, unless an error ends the run.

        Args:
            live: Whether to serve the recording to live viewers, too.
            draws: Whether to draw anything, a recording in particular.

        Raises:
            InvalidInputError: A live view is wanted, and nothing is to be drawn.
        """
        if live and not draws:
            raise InvalidInputError("--live serves the recording: omit --no-recording")
        self.draws = draws
        self.writer = self._stack.enter_context(self._recording(live=live))
        self.clock = ViewerClock(time.monotonic)
        return self.writer

    def guard(self, interrupt: Callable[[], None]) -> None:
        """Call `interrupt` as soon as a lease is lost; the context then raises LeaseLostError."""
        self._stack.enter_context(self.archive.leases.guarding(interrupt))

    def say_how_to_resume(self) -> None:
        """Print from now on how to resume the run when it is interrupted."""
        name = self.folder.path.name
        self._stack.enter_context(self.storage.saying_how_to_resume(self.console, name))

    def _lease(
        self,
        descriptions: Mapping[str, Description],
        moves: Moves,
        run_id: str,
        *,
        patient: bool,
    ) -> Archive:
        fleet, name, _ = self.connection
        fleet.check_may_command()
        agree(self._command, descriptions.values(), moves, fleet.health, self.console)
        self._stack.enter_context(self._saying_who_rests(tuple(descriptions)))
        watches = [fleet.watch(robot) for robot in descriptions]
        self._stack.enter_context(motions_shown(self.console, watches))
        scope = self.choice.reach.lease_scope(name, run_id)
        leases = lease_robots(
            self.repository.leases,
            fleet,
            scope,
            descriptions,
            patient=patient,
            on_wait=self._say_who_is_waited_for,
        )
        self.archive = Archive(self.repository, name, self._stack.enter_context(leases))
        return self.archive

    def _say_who_is_waited_for(self, held: LeaseHeldError) -> None:
        self.console.print(
            f"{held.owner} held {held.robot} when it was last heard of; "
            f"its lease runs out in {held.remaining_s:.1f} s"
        )

    @contextmanager
    def _saying_who_rests(self, robots: tuple[str, ...]) -> Iterator[None]:
        """Print after an interrupt, when the rest has been closed, that robots are at rest."""
        try:
            yield
        except KeyboardInterrupt:
            watches = [self.connection.fleet.watch(robot) for robot in robots]
            say_who_rests(self.console, watches)
            raise

    @contextmanager
    def _recording(self, *, live: bool) -> Iterator[RerunWriter]:
        folder, console = self.folder, self.console
        serve = ServeOptions(grpc_port=GRPC_PORT, web_port=WEB_PORT) if live else None
        recording = folder.recording if self.draws else None
        with RerunWriter(folder.path.name, recording=recording, serve=serve) as writer:
            if live:
                console.print(f"live: `nufleet view --live`, or {writer.web_url} in a browser")
            yield writer
        if recording is None:
            return
        if writer.dropped:
            console.print(
                f"[yellow]the recording and its viewers missed {writer.dropped} events[/]"
            )
        console.print(f"open the recording with:  {invocation()} view {folder.path}")
