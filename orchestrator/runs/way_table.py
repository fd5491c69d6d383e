"""The ways to fly a path for people, and in the result of a ranking."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table

from nufleet.orchestrator.flights.labels import BASELINE
from nufleet.orchestrator.flights.ways import Foresight, advice, described, error_range
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.orchestrator.study.verdict_document import rehearsed


def with_ways(result: RankResult, foresight: Foresight) -> RankResult:
    """Return the result of a ranking with what the target expects of each way to fly.

    Where the experience of a source was rehearsed, the rehearsal decides the verdict on it.
    """
    verdicts, expected = dict(result.verdicts), foresight.now
    for source, found in expected.items():
        if source in verdicts and BASELINE in expected:
            baseline = expected[BASELINE]
            verdicts[source] = rehearsed(
                verdicts[source], found, baseline, foresight.size, foresight.path
            )
    return result.model_copy(
        update={
            "verdicts": verdicts,
            "ways_path": foresight.path,
            "ways": foresight.ways,
            "chosen_way": foresight.chosen,
        }
    )


def way_parts(foresight: Foresight) -> Iterator[RenderableType]:
    """Yield the table of ways, why some are not in it, and one sentence that says which to take."""
    title = f"{foresight.target} on {foresight.path}: the error it expects, with 90 % bounds"
    table = Table(title=title, title_justify="left")
    table.add_column("way")
    table.add_column("expected error", justify="right")
    present_s = min(way.own_flight_s for way in foresight.ways)
    chosen = foresight.chosen
    missing = []
    for way in foresight.ways:
        name, found = described(way, present_s), way.predicted
        if found is None:
            missing.append(f"  {name}: {way.reason}")
        elif way.way == chosen and way.own_flight_s <= present_s:
            table.add_row(
                f"[bold green]{name}[/]", f"[bold]{error_range(found, foresight.unit)}[/]"
            )
        else:
            table.add_row(name, error_range(found, foresight.unit))
    yield table
    yield from missing
    yield f"[bold]{advice(foresight)}[/]"
