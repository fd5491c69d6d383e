"""Runs a study together with its display: progress, recording, live view and result."""

from __future__ import annotations

from datetime import UTC, datetime

from nufleet.orchestrator.conduct.rank_run import ReadyStudy, run_study
from nufleet.orchestrator.conduct.reuse import said_of
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.repository.records import StudyRecord
from nufleet.orchestrator.runs.console import ConsoleObserver, ranking_table
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.orchestrator.runs.verdict_table import verdict_parts
from nufleet.orchestrator.viewer.study_feed import LiveView


def follow_study(run: Opening, ready: ReadyStudy, study: StudyRecord) -> RunRecord:
    """Run a study from its present state to its result, and show its progress; see `run_study`.

    Args:
        run: Everything that is open, recording included.
        ready: Study, prepared and checked.
        study: The stored study.

    Returns:
        The record of the run, as stored in its folder.
    """
    fleet = run.connection.fleet
    unit = ready.descriptions[ready.plan.target].spec.axis(ready.plan.axis).unit
    view = LiveView(ready.plan, unit, run.clock, run.writer.emit)
    view.watch(fleet)
    try:
        return run_study(
            fleet,
            ready,
            study,
            run.archive,
            folder=run.folder,
            observers=[ConsoleObserver(run.console, ready.plan.iterations), view],
        )
    finally:
        view.stop_watching()


def show_study(run: Opening, ready: ReadyStudy, study: StudyRecord) -> RunRecord:
    """Run a study like `follow_study`, and print its result."""
    console = run.console
    record = follow_study(run, ready, study)
    console.print(ranking_table(record.result.ranking, record.closed_form))
    for robot, stored in (record.result.stored or {}).items():
        console.print(f"[yellow]{said_of(robot, stored, datetime.now(UTC))}[/]")
    for part in verdict_parts(record.result):
        console.print(part)
    console.print(
        f"selected: [bold green]{record.result.selected}[/]  "
        f"({record.result.robot_time_s:.0f} robot-seconds, {record.wall_time_s:.1f} s)"
    )
    return record
