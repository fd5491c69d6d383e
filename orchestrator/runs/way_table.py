"""The ways to fly a path for people, and in the result of a ranking."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table

from nufleet.orchestrator.flights.labels import BASELINE
from nufleet.orchestrator.flights.ways import (
    Foresight,
    WayRecord,
    advice,
    described,
    error_range,
)
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.orchestrator.study.verdict_document import rehearsed


def with_ways(result: RankResult, foresight: Foresight, size: float) -> RankResult:
    """Return the result of a ranking with what the target expects of each way to fly.

    Where the experience of a source was rehearsed, the rehearsal decides the verdict on it.

    Args:
        result: Result from the tests alone.
        foresight: What the target expects.
        size: Root mean square of the path about its mean, in the unit of the axes.
    """
    verdicts, expected = dict(result.verdicts), foresight.now
    for source, found in expected.items():
        if source in verdicts and BASELINE in expected:
            verdicts[source] = rehearsed(
                verdicts[source], found, expected[BASELINE], size, foresight.path
            )
    return result.model_copy(
        update={
            "verdicts": verdicts,
            "ways_path": foresight.path,
            "ways_unit": foresight.unit,
            "ways": foresight.ways,
            "chosen_way": foresight.chosen,
        }
    )


def way_parts(foresight: Foresight) -> Iterator[RenderableType]:
    """Yield the table of ways, why some are not in it, and one sentence that says which to take."""
    table = Table(title=_title(foresight), title_justify="left")
    table.add_column("way")
    table.add_column("expected error", justify="right")
    for way, name, error in _rows(foresight):
        best = way.way == foresight.chosen and way.own_flight_s == foresight.present_s
        table.add_row(name, error, style="bold green" if best else None)
    yield table
    for name, reason in _missing(foresight):
        yield f"  {name}: {reason}"
    if foresight.unseen is not None:
        yield f"[yellow]{foresight.target}: {foresight.unseen}[/]"
    yield f"[bold]{advice(foresight)}[/]"


def foresight_of(result: RankResult) -> Foresight | None:
    """Return what the target expected when it was ranked; None where nothing was predicted."""
    if result.ways_path is None or result.ways_unit is None:
        return None
    return Foresight(result.target, result.ways_path, result.ways_unit, result.ways)


def way_markdown(result: RankResult) -> list[str]:
    """Return the same as lines for a report; none where nothing was predicted."""
    foresight = foresight_of(result)
    if foresight is None:
        return []
    table = [f"| {name} | {error} |" for _, name, error in _rows(foresight)]
    missing = [f"- {name}: {reason}" for name, reason in _missing(foresight)]
    title = [f"{_title(foresight)}:", "", "| way | expected error |", "|---|---|"]
    if foresight.unseen is not None:
        missing.append(f"- {foresight.target}: {foresight.unseen}")
    return [f"**{advice(foresight)}**", "", *title, *table, "", *missing]


def _title(foresight: Foresight) -> str:
    return f"{foresight.target} on {foresight.path}: the error it expects, with 90 % bounds"


def _rows(foresight: Foresight) -> Iterator[tuple[WayRecord, str, str]]:
    for way in foresight.ways:
        if way.predicted is not None:
            name = described(way, foresight.present_s)
            yield way, name, error_range(way.predicted, foresight.unit)


def _missing(foresight: Foresight) -> Iterator[tuple[str, str]]:
    for way in foresight.ways:
        if way.reason is not None:
            yield described(way, foresight.present_s), way.reason
