"""Runs a study with everything that shows it: progress, recording, live view, result."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from datetime import UTC, datetime

from rich.console import Console

from orchestrator.archive import Archive
from orchestrator.console import ConsoleObserver, ranking_table
from orchestrator.fleet import Fleet
from orchestrator.live_view import LiveView
from orchestrator.rank_run import ReadyStudy, run_study
from orchestrator.repository.records import StudyRecord
from orchestrator.results import RunRecord
from orchestrator.run_folder import RunFolder
from orchestrator.stored_responses import said_of
from orchestrator.study_clock import StudyClock
from orchestrator.verdict_table import verdict_parts
from orchestrator.viewer.ports import GRPC_PORT, WEB_PORT
from orchestrator.viewer.writer import RerunWriter, ServeOptions
from shared.command_line import invocation


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
    """Run a study from where it stands to its result, and print that; see `run_study`.

    `begin` returns the study, stored; it is called when everything that shows it is there.
    """
    with ExitStack() as stack:
        serve = ServeOptions(grpc_port=GRPC_PORT, web_port=WEB_PORT) if live else None
        writer = stack.enter_context(
            RerunWriter(folder.path.name, recording=folder.recording, serve=serve)
        )
        if live:
            console.print(f"live: `nufleet view --live`, or {writer.web_url} in a browser")
        unit = ready.descriptions[ready.plan.target].spec.axis(ready.plan.axis).unit
        view = LiveView(ready.plan, unit, StudyClock(time.monotonic), writer.emit)
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
