"""Draws the error against own flying of several evaluations side by side, and prints their tables.

Nothing is flown here: the figures come from finished runs of `nufleet evaluate`, whose folders are
given. The tables are in Markdown, as the documentation shows them.

    nufleet evaluate --fleet paper_linear ...
    python -m benchmarks.evaluation_curves runs/*-evaluate --figure docs/images/curves.png \\
        --summary README.md docs/evaluation.md --tables docs/evaluation.md
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from nufleet.orchestrator.evaluation.error_curve import curves_of, draw_curve
from nufleet.orchestrator.evaluation.report import error_cell
from nufleet.orchestrator.evaluation.results import (
    EVALUATION,
    EvaluationRecord,
    EvaluationResult,
    WayResult,
)
from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.runs.figures import new_figure, save

SHOWN_S = (0, 15, 30, 120)
"""Durations of own flying that the summary has columns for."""
COLUMNS = 2
LEGEND_SHARE = 0.22  # of the height of the lines, kept free above them
WIDTH_IN, HEIGHT_IN = 6.0, 4.0


def read(run: Path) -> tuple[str, EvaluationRecord]:
    """Return the name of a run's fleet, and its evaluation.

    Args:
        run: Folder of the run, whose name is `{time}-{fleet}-evaluate`.
    """
    text = (run / EVALUATION).read_text(encoding="utf-8")
    fleet = run.name.partition("-")[2].removesuffix("-evaluate")
    return fleet, EvaluationRecord.model_validate_json(text)


def draw(png: Path, evaluations: Sequence[tuple[str, EvaluationRecord]]) -> None:
    """Draw one panel for each evaluation.

    Args:
        png: File to write.
        evaluations: Name of the fleet and result of each.
    """
    rows = -(-len(evaluations) // COLUMNS)
    figure = new_figure(COLUMNS * WIDTH_IN, rows * HEIGHT_IN)
    grid = figure.subplots(rows, COLUMNS, squeeze=False).ravel()
    for axes, (fleet, record) in zip(grid, evaluations, strict=False):
        draw_curve(axes, record.result)
        axes.set_title(f"{fleet}, {_paths(record)} paths", loc="left", fontsize=10)
        low, high = axes.get_ylim()
        axes.set_ylim(low, high * (high / low) ** LEGEND_SHARE)
        axes.legend(frameon=False, fontsize=7, ncols=3, loc="upper left")
    for axes in grid[len(evaluations) :]:
        axes.axis("off")
    save(figure, png)


def summary(evaluations: Sequence[tuple[str, EvaluationRecord]]) -> list[str]:
    """Return one table of all evaluations, line by line: a row for each, a column for each way."""
    # Robots fly whole samples, so that durations differ by fractions of a second.
    flown_s = {round(p.own_flight_s) for _, record in evaluations for p in record.result.points}
    every = [s for s in SHOWN_S if s in flown_s]
    names = ["baseline", "none", "worst source", "best source", "mixture"]
    own = [f"own after {s} s" if s else "own after its tests" for s in every]
    lines = [
        "| fleet | " + " | ".join([*names, *own]) + " | chosen at first |",
        "|---" * (2 + len(names) + len(own)) + "|",
    ]
    for fleet, record in evaluations:
        curves, result = curves_of(record.result), record.result
        at = {(w.way, round(w.own_flight_s)): w for w in result.ways}
        flown = [curves[name][0] if name in curves else None for name in names]
        flown += [at.get((OWN, s)) for s in every]
        cells = ["" if way is None else error_cell(way) for way in flown]
        lines.append(
            f"| {fleet}, m{result.unit} | {' | '.join(cells)} | {result.chosen_way or ''} |"
        )
    return lines


def rows_of(result: EvaluationResult) -> list[str]:
    """Return the table of one evaluation, line by line."""
    sources = sorted(
        (way for way in result.ways if way.way in {source.robot for source in result.sources}),
        key=lambda way: float("inf") if way.rms_m is None else way.rms_m,
    )
    named = {BASELINE: "baseline", NO_PRIOR: "none: learns in flight", MIXTURE: "mixture of all"}
    lines = [
        f"| way | own flying, s | RMS error, m{result.unit} | less error | expected | withdrawn |",
        "|---|---|---|---|---|---|",
    ]
    ways = [way for name in (BASELINE, NO_PRIOR) for way in result.ways if way.way == name]
    ways += sources
    ways += [w for name in (MIXTURE, OWN) for w in result.ways if w.way == name]
    return lines + [_row(way, named.get(way.way, way.way)) for way in ways]


def _row(way: WayResult, name: str) -> str:
    expected = "-"
    if way.predicted_rms_m is not None:
        expected = (
            f"{_milli(way.predicted_rms_m)} "
            f"({_milli(way.predicted_low_m)} to {_milli(way.predicted_high_m)})"
        )
    less = "" if way.reduction_percent is None else f"{way.reduction_percent:.1f} %"
    cells = (name, f"{way.own_flight_s:.0f}", error_cell(way), less, expected, way.taken_back)
    return "| " + " | ".join(str(cell) for cell in cells) + " |"


def _milli(value: float | None) -> str:
    return "not finished" if value is None else f"{1000 * value:.3g}"


def _paths(record: EvaluationRecord) -> int:
    return len({(flight.drawing, flight.speed_m_s) for flight in record.flights})


def choices(result: EvaluationResult) -> list[str]:
    """Return what the predictions chose and how they held, as a list in Markdown."""
    lines = []
    for point in result.points:
        if point.chosen_way is not None:
            when = f"after {point.own_flight_s:.0f} s" if point.own_flight_s else "after its tests"
            lines.append(
                f"- {when} the predictions choose {point.chosen_way}; regret "
                f"{_milli(point.regret_m)} m{result.unit}"
            )
    held = [f"{way} {each.inside} of {each.flights}" for way, each in result.coverage.items()]
    if held:
        lines.append(f"- errors inside the interval predicted for them (90 %): {', '.join(held)}")
    lines.append(f"- flights worse than the baseline: {result.worse_than_baseline}")
    return lines


def document(evaluations: Sequence[tuple[str, EvaluationRecord]]) -> str:
    """Return the tables of every single evaluation in Markdown."""
    parts = []
    for fleet, record in evaluations:
        parts += [
            f"### {fleet}, {_paths(record)} paths",
            "\n".join(rows_of(record.result)),
            "\n".join(choices(record.result)),
        ]
    return "\n\n".join(parts)


def with_part(text: str, name: str, part: str) -> str:
    """Return a document with what stands between the two marks of a part replaced.

    Raises:
        ValueError: The document lacks a mark.
    """
    begin, end = f"<!-- {name} -->", f"<!-- end of {name} -->"
    before, _, rest = text.partition(begin)
    _, found, after = rest.partition(end)
    if not found:
        raise ValueError(f"there is no {begin!r} followed by {end!r}")
    return f"{before}{begin}\n\n{part}\n\n{end}{after}"


def main() -> None:
    """Draw the figure, and print the tables or write them into documents."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+", type=Path, help="folders of runs of nufleet evaluate")
    parser.add_argument("--figure", type=Path, help="picture to write")
    parser.add_argument("--summary", nargs="*", type=Path, default=(), help="documents to update")
    parser.add_argument("--tables", nargs="*", type=Path, default=(), help="documents to update")
    arguments = parser.parse_args()
    evaluations = [read(run) for run in arguments.runs]
    parts = {"summary": "\n".join(summary(evaluations)), "tables": document(evaluations)}
    for name, part in parts.items():
        print(f"{part}\n")
        for path in getattr(arguments, name):
            text = path.read_text(encoding="utf-8")
            path.write_text(with_part(text, name, part), encoding="utf-8")
    if arguments.figure is not None:
        draw(arguments.figure, evaluations)


if __name__ == "__main__":
    main()
