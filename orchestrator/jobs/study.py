"""Runs a study together with its display: progress, recording, live view and result."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from operator import call

from nufleet.orchestrator.conduct.desired_motion import TimedPath
from nufleet.orchestrator.conduct.rank_run import ReadyStudy, run_study
from nufleet.orchestrator.conduct.reuse import said_of
from nufleet.orchestrator.flights.ways import Foresight
from nufleet.orchestrator.jobs.foresight import foreseen
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.runs.console import ConsoleObserver, record_table
from nufleet.orchestrator.runs.headline import Headline, write_headline
from nufleet.orchestrator.runs.rank_result import RankResult, RunRecord
from nufleet.orchestrator.runs.verdict_table import verdict_parts
from nufleet.orchestrator.runs.way_table import way_parts, with_ways
from nufleet.orchestrator.viewer.study_feed import LiveView
from nufleet.shared.errors import StudyError


def follow_study(
    run: Opening,
    ready: ReadyStudy,
    study: StudyRecord,
    foresee: Callable[[RankResult], RankResult] = lambda result: result,
    draw: Callable[[Callable[[], None]], object] = call,
) -> RunRecord:
    """Run a study from its present state to its result, and show its progress; see `run_study`.

    Args:
        run: Everything that is open, recording included.
        ready: Study, prepared and checked.
        study: The stored study.
        foresee: Function that adds to the result what the target expects of each way to fly.
        draw: Function that has the plots drawn, by what it is given, now or later.

    Returns:
        The record of the run, as stored in its folder.
    """
    fleet = run.connection.fleet
    unit = ready.descriptions[ready.plan.target].spec.axis(ready.plan.axis).unit
    specs = {robot: one.spec for robot, one in ready.descriptions.items()}
    view = LiveView(ready.plan, unit, run.clock, run.writer.emit)
    view.watch(fleet)
    try:
        return run_study(
            fleet,
            ready,
            study,
            run.archive,
            folder=run.folder,
            draws=run.draws,
            observers=[ConsoleObserver(run.console, ready.plan.iterations, specs), view],
            foresee=foresee,
            draw=draw,
        )
    except StudyError as error:
        if run.repository.studies.study(study.study_id).status is StudyStatus.FAILED:
            write_headline(run.folder.path, Headline(failure=str(error)))
        raise
    finally:
        view.stop_watching()


def show_study(
    run: Opening,
    ready: ReadyStudy,
    study: StudyRecord,
    drawing: TimedPath | None = None,
    *,
    rehearses: bool = True,
) -> RunRecord:
    """Run a study like `follow_study`, and print its result and which way to fly.

    Args:
        run: Everything that is open, recording included.
        ready: Study, prepared and checked.
        study: The stored study.
        drawing: Drawing to be flown; None for a typical one.
        rehearses: Whether the target is asked what error it expects of each way to fly.
    """
    console = run.results
    found: list[Foresight] = []

    def foresee(result: RankResult) -> RankResult:
        answer = foreseen(run, ready, result, drawing) if rehearses else None
        if answer is None:
            return result
        foresight, leg = answer
        found.append(foresight)
        return with_ways(result, foresight, leg.size)

    record = follow_study(run, ready, study, foresee)
    console.print(record_table(record))
    for robot, stored in (record.result.stored or {}).items():
        console.print(f"[yellow]{said_of(robot, stored, datetime.now(UTC))}[/]")
    for part in verdict_parts(record.result):
        console.print(part)
    for robot, reason in record.dropped.items():
        console.print(f"[red]{robot} was left out: {reason}[/]")
    console.print(
        f"selected: [bold green]{record.result.selected}[/]  "
        f"({record.result.robot_time_s:.0f} robot-seconds, {record.wall_time_s:.1f} s)"
    )
    for foresight in found:
        for part in way_parts(foresight):
            console.print(part)
    return record
