"""The verdicts of a ranking for people, as a table on a terminal and one in a report."""

from __future__ import annotations

from collections.abc import Iterator

from rich.console import RenderableType
from rich.table import Table

from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.orchestrator.study.verdict import Verdict
from nufleet.orchestrator.study.verdict_document import Bounds, TransferVerdict

HEADINGS = ("source", "remaining error", "without transfer", "ψ*", "verdict")
COLOURS = {
    Verdict.TRANSFER: "green",
    Verdict.DO_NOT_TRANSFER: "red",
    Verdict.NEED_MORE_TESTS: "yellow",
}


def verdict_title(result: RankResult) -> str:
    """Return a title that names the transfers and the motion."""
    low, high = result.band_rad_s
    motion = f"a motion of equal size at every frequency from {low:g} to {high:g} rad/s"
    return f"transfer to {result.target}, on {result.trajectory or motion}"


def verdict_rows(result: RankResult) -> Iterator[tuple[TransferVerdict, tuple[str, ...]]]:
    """Yield each source's verdict and its row, in the order of the ranking.

    Errors are shares of the motion's root mean square, with their bounds. A source whose experience
    was rehearsed is left out: the table of ways tells more of it.
    """
    rehearsed = _rehearsed(result)
    for estimate in result.ranking:
        found = result.verdicts.get(estimate.robot)
        if found is not None and estimate.robot not in rehearsed:
            errors = _percent(found.error_with), _percent(found.error_without)
            yield found, (estimate.robot, *errors, f"{estimate.psi:.4f}", found.verdict)


def _rehearsed(result: RankResult) -> set[str]:
    return {way.way for way in result.ways if way.predicted is not None}


def verdict_parts(result: RankResult) -> Iterator[RenderableType]:
    """Yield the table and the reasons below it; nothing where there is no verdict."""
    rows = list(verdict_rows(result))
    if not rows:
        return
    table = Table(*HEADINGS, title=verdict_title(result), title_justify="left")
    for found, row in rows:
        table.add_row(*row[:-1], f"[{COLOURS[found.verdict]}]{row[-1]}[/]")
    yield table
    for found, row in rows:
        yield f"  {row[0]}: {found.reason}"
    for robot in sorted(_rehearsed(result) & set(result.verdicts)):
        yield f"  {robot}: it has learned and was rehearsed, see the table of all ways to fly"


def verdict_markdown(result: RankResult) -> list[str]:
    """Return the lines for a report; none where there is no verdict."""
    rows = [(*row, found.reason) for found, row in verdict_rows(result)]
    if not rows:
        return []
    headings = (*HEADINGS, "why")
    title = verdict_title(result)
    lines = (headings, ("---",) * len(headings), *rows)
    return [f"T{title[1:]}:", "", *(f"| {' | '.join(row)} |" for row in lines)]


def _percent(error: Bounds) -> str:
    low, median, high = (100 * value for value in (error.low, error.median, error.high))
    return f"{median:.3g} % ({low:.3g} to {high:.3g})"
