"""Two runs side by side: what was set differently, and how far their results are apart."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

from rich.console import RenderableType
from rich.table import Column, Table

from nufleet.orchestrator.evaluation.flight_documents import DemoResult, TrackResult
from nufleet.orchestrator.evaluation.results import EvaluationRecord, FlightRecord
from nufleet.orchestrator.history.catalogue import Run
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.strict import Document, Strict

_OF_EACH_RUN = {"command", "reach", "repository", "runs_root", "as_json", "live"}
"""Settings that say where a run took place, not what it did."""


class Setting(Strict):
    """A setting that differs; None where a run has none of that name."""

    name: str
    """Name of the setting, with dots between the levels."""
    first: Any
    """Value in the first run."""
    second: Any
    """Value in the second run."""


class Compared(Strict):
    """A number that both runs have."""

    what: str
    """What was estimated or measured: a source, or a flight."""
    first: float
    """Value in the first run."""
    second: float
    """Value in the second run."""
    spread: float | None = None
    """Half the width of the 95 % interval of the difference, from the intervals of both; None where
    these are not known."""


class Comparison(Document):
    """The document that `nufleet runs compare --json` prints."""

    first: str
    """Name of the first run."""
    second: str
    """Name of the second run."""
    headlines: tuple[str, str]
    """What each run came to, in one line."""
    settings: tuple[Setting, ...]
    """Settings that differ, versions of packages included."""
    psi: tuple[Compared, ...]
    """Estimates ψ* of the sources that both ranked, in the order of the first."""
    rms: tuple[Compared, ...]
    """RMS errors of the flights that both flew, in the unit of the robots' axes."""


def compare_runs(
    first: Run, second: Run, configurations: tuple[dict[str, Any], dict[str, Any]]
) -> Comparison:
    """Compare two runs.

    Args:
        first: A run.
        second: Another run.
        configurations: Their configurations, as they lie in their folders.

    Raises:
        InvalidInputError: A run has no result.
    """
    for run in (first, second):
        if run.result is None:
            raise InvalidInputError(f"{run.folder.name} has no result to compare: it did not end")
    settings = tuple(map(_flat, configurations))
    return Comparison(
        first=first.folder.name,
        second=second.folder.name,
        headlines=(first.headline, second.headline),
        settings=tuple(
            Setting(name=name, first=settings[0].get(name), second=settings[1].get(name))
            for name in sorted(settings[0].keys() | settings[1].keys())
            if settings[0].get(name) != settings[1].get(name)
        ),
        psi=tuple(_psi(first.ranking, second.ranking)),
        rms=tuple(_rms(_flights(first), _flights(second))),
    )


def comparison_parts(found: Comparison) -> Iterator[RenderableType]:
    """Yield a comparison as tables, with lines of text between them."""
    for name, headline in zip((found.first, found.second), found.headlines, strict=True):
        yield f"{name}: [bold]{headline}[/]"
    if found.settings:
        table = Table("setting", "first", "second", title="what differs", title_justify="left")
        for setting in found.settings:
            table.add_row(setting.name, *map(_short, (setting.first, setting.second)))
        yield table
    else:
        yield "all settings are the same"
    if found.psi:
        yield _numbers("ψ* of each source", "source", found.psi, 1.0, 4)
    if found.rms:
        yield _numbers("RMS error of each flight, in thousandths", "flight", found.rms, 1000.0, 1)
    if not found.psi and not found.rms:
        yield "they have no source and no flight in common"


def _numbers(
    title: str, what: str, rows: tuple[Compared, ...], factor: float, digits: int
) -> Table:
    sure = any(row.spread is not None for row in rows)
    headings = ("first", "second", "difference", *(("±, 95 %",) if sure else ()))
    numbers = [Column(heading, justify="right") for heading in headings]
    table = Table(what, *numbers, title=title, title_justify="left")
    for row in rows:
        first, second = factor * row.first, factor * row.second
        spread = ("" if row.spread is None else f"{row.spread:.4f}",) if sure else ()
        cells = (f"{first:.{digits}f}", f"{second:.{digits}f}", f"{second - first:+.{digits}f}")
        table.add_row(row.what, *cells, *spread)
    return table


def _flights(run: Run) -> tuple[FlightRecord, ...]:
    match run.result:
        case TrackResult() as tracking:
            return tracking.flights
        case EvaluationRecord() as evaluation:
            return evaluation.flights
        case DemoResult() as demo:
            return demo.flown
    return ()


def _psi(first: RankResult | None, second: RankResult | None) -> Iterator[Compared]:
    if first is None or second is None:
        return
    others = {one.robot: one for one in second.ranking}
    for one in first.ranking:
        other = others.get(one.robot)
        if other is not None:
            halves = [(each.psi_high - each.psi_low) / 2 for each in (one, other)]
            spread = math.hypot(*halves)
            yield Compared(what=one.robot, first=one.psi, second=other.psi, spread=spread)


def _rms(first: tuple[FlightRecord, ...], second: tuple[FlightRecord, ...]) -> Iterator[Compared]:
    others = _by_flight(second)
    for name, rms in _by_flight(first).items():
        if name in others:
            yield Compared(what=name, first=rms, second=others[name])


def _by_flight(flights: tuple[FlightRecord, ...]) -> dict[str, float]:
    """Return the error of each flight that was finished, by what was flown."""
    found: dict[str, float] = {}
    for one in flights:
        if one.rms_m is not None:
            more = f", after {one.beyond_tests_s:g} s more" if one.beyond_tests_s else ""
            name = f"{one.target} with {one.inverse} on {one.drawing} at {one.speed_m_s:g}/s{more}"
            found.setdefault(name, one.rms_m)
    return found


def _flat(configuration: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    """Return nested settings by their names with dots, without those of each run alone."""
    found: dict[str, Any] = {}
    for name, value in configuration.items():
        if not prefix and name in _OF_EACH_RUN:
            continue
        if isinstance(value, dict):
            found |= _flat(value, f"{prefix}{name}.")
        elif not name.endswith("boot_id"):
            found[f"{prefix}{name}"] = value
    return found


def _short(value: Any) -> str:
    return "–" if value is None else f"{value!s:.60}"
