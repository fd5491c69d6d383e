"""The tables that `nufleet runs show` prints for a completed run."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime

from rich.console import RenderableType
from rich.table import Column, Table

from nufleet.orchestrator.conduct.reuse import said_of
from nufleet.orchestrator.evaluation.demo_table import demo_parts
from nufleet.orchestrator.evaluation.flight_documents import DemoResult, TrackResult, TrainResult
from nufleet.orchestrator.evaluation.pairs import PairsResult
from nufleet.orchestrator.evaluation.report import evaluation_table, pairs_table
from nufleet.orchestrator.evaluation.results import EvaluationRecord, FlightRecord
from nufleet.orchestrator.history.catalogue import Run
from nufleet.orchestrator.runs.console import ranking_table, record_table
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.orchestrator.runs.verdict_table import verdict_parts
from nufleet.orchestrator.runs.way_table import foresight_of, way_parts


def run_tables(run: Run) -> Iterator[RenderableType]:
    """Yield the results of a run as tables, with lines of text between them."""
    match run.result:
        case RunRecord() as record:
            yield from _ranking(record)
        case DemoResult() as demo:
            yield ranking_table(demo.ranking.ranking, {})
            yield from verdict_parts(demo.ranking)
            yield from demo_parts(demo)
        case EvaluationRecord() as evaluation:
            yield evaluation_table(evaluation.result)
            yield flights_table(evaluation.flights)
        case PairsResult() as pairs:
            for target in pairs.targets:
                yield evaluation_table(target)
            yield pairs_table(pairs)
        case TrackResult() as tracking:
            yield flights_table(tracking.flights)
        case TrainResult() as training:
            yield experiences_table(training)


def _ranking(record: RunRecord) -> Iterator[RenderableType]:
    result = record.result
    low, high = result.band_rad_s
    yield (
        f"target: {result.target}, {record.axes_in_words}, band {low:g} to {high:g} rad/s, "
        f"seed {record.seed}"
    )
    yield record_table(record)
    rounds = "1 round" if result.iterations == 1 else f"{result.iterations} rounds"
    yield f"{rounds} of tests, in which all robots together moved for {result.robot_time_s:.0f} s"
    for source, reason in (result.eliminated or {}).items():
        yield f"{source} was not tested to the end: {reason}"
    if result.confidence is not None:
        why = f": {result.stopped_because}" if result.stopped_because else ""
        yield f"probability of a correct selection: {result.confidence:.3f}{why}"
    for robot, stored in (result.stored or {}).items():
        yield f"[yellow]{said_of(robot, stored, datetime.now(UTC))}[/]"
    yield from verdict_parts(result)
    foresight = foresight_of(result)
    if foresight is not None:
        yield from way_parts(foresight)
    for robot, reason in record.dropped.items():
        yield f"[red]{robot} was left out: {reason}[/]"


def flights_table(flights: tuple[FlightRecord, ...]) -> Table:
    """Return a table of flights along a drawing, with the robot's distance from it."""
    table = Table(title="flights along drawings", title_justify="left")
    for heading in ("robot", "drawing", "prior"):
        table.add_column(heading, no_wrap=True)
    for heading in ("m/s", "RMS, mm"):
        table.add_column(heading, justify="right")
    table.add_column("remarks")
    for flight in flights:
        rms = "not finished" if flight.rms_m is None else _milli(flight.rms_m)
        after = f" after {flight.own_flight_s:g} s" if flight.own_flight_s else ""
        event = flight.failure or (flight.taken_back and f"withdrawn: {flight.taken_back}") or ""
        table.add_row(
            *(
                flight.target,
                flight.drawing,
                flight.inverse + after,
                f"{flight.speed_m_s:g}",
                rms,
                event,
            )
        )
    return table


def _milli(value: float) -> str:
    return "<0.1" if value < 5e-5 else f"{1000 * value:.1f}"


def experiences_table(result: TrainResult) -> Table:
    """Return a table of the experiences that robots offer after a training."""
    headings = ("horizon, s", "relative degree", "validation error", "training, s")
    numbers = [Column(one, justify="right") for one in headings]
    table = Table("robot", "architecture", *numbers, title="experiences on offer")
    table.title_justify = "left"
    for one in result.experiences:
        manifest = one.manifest
        table.add_row(
            one.robot,
            manifest.layout.architecture,
            f"{manifest.layout.horizon_s:.2f}",
            str(manifest.relative_degree),
            f"{100 * manifest.validation_rms / manifest.output_scale:.1f} %",
            f"{one.training_time_s:.1f}",
        )
    return table
