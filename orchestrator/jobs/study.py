"""Runs a study together with its display: progress, recording, live view and result."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime

from rich.console import Console

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.rank_run import ReadyStudy, run_study
from nufleet.orchestrator.conduct.reuse import said_of
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.records import StudyRecord
from nufleet.orchestrator.runs.console import ConsoleObserver, ranking_table
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.orchestrator.runs.verdict_table import verdict_parts
from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT, WEB_PORT
from nufleet.orchestrator.viewer.study_feed import LiveView
from nufleet.orchestrator.viewer.writer import RerunWriter, ServeOptions
from nufleet.shared.command_line import invocation


def show_study(
    fleet: Fleet,
    ready: ReadyStudy,
    begin: Callable[[], StudyRecord],
    archive: Archive,
    *,
    folder: RunFolder,
    live: bool,
    console: Console,
) -> RunRecord:
    """Run a study from its present state to its result, and print the result; see `run_study`.

    Args:
        fleet: Client of the fleet, already connected.
        ready: Study, prepared and checked.
        begin: Function that returns the stored study; called once the display is open.
        archive: Repository that stores the study, with the leases on the robots.
        folder: Folder of the run.
        live: Whether to serve the recording to live viewers.
        console: Console for progress and the result.

    Returns:
        The record of the run, as stored in its folder.
    """
    with ExitStack() as stack:
        serve = ServeOptions(grpc_port=GRPC_PORT, web_port=WEB_PORT) if live else None
        writer = stack.enter_context(
            RerunWriter(folder.path.name, recording=folder.recording, serve=serve)
        )
        if live:
            console.print(f"live: `nufleet view --live`, or {writer.web_url} in a browser")
        unit = ready.descriptions[ready.plan.target].spec.axis(ready.plan.axis).unit
        view = LiveView(ready.plan, unit, ViewerClock(time.monotonic), writer.emit)
        view.watch(fleet)
        stack.callback(view.stop_watching)
        record = run_study(
            fleet,
            ready,
            begin(),
            archive,
            folder=folder,
            observers=[ConsoleObserver(console, ready.plan.iterations), view],
        )
    console.print(ranking_table(record.result.ranking, record.closed_form))
    for robot, stored in (record.result.stored or {}).items():
        console.print(f"[yellow]{said_of(robot, stored, datetime.now(UTC))}[/]")
    for part in verdict_parts(record.result):
        console.print(part)
    console.print(
        f"selected: [bold green]{record.result.selected}[/]  "
        f"({record.result.robot_time_s:.0f} robot-seconds, {record.wall_time_s:.1f} s)"
    )
    if writer.dropped:
        console.print(f"[yellow]the recording and its viewers missed {writer.dropped} events[/]")
    console.print(f"open the recording with:  {invocation()} view {folder.path}")
    return record
