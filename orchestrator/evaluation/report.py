"""The tables and figures of an evaluation, with the paper's own numbers for comparison."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from rich.table import Table

from nufleet.orchestrator.evaluation.error_curve import error_curve
from nufleet.orchestrator.evaluation.pairs import PairsResult, transfer_pairs
from nufleet.orchestrator.evaluation.plots import fig4, fig7, paths, scatter
from nufleet.orchestrator.evaluation.results import (
    ByAxisResult,
    EvaluationRecord,
    EvaluationResult,
    InverseResult,
    SourceResult,
)
from nufleet.orchestrator.evaluation.values import FlightError, FlownPath
from nufleet.orchestrator.flights.labels import (
    BY_AXIS,
    MIXTURE,
    NO_PRIOR,
    OWN,
    flight_label,
    path_label,
)
from nufleet.orchestrator.study.source_by_axis import in_words, sources_by_axis
from nufleet.shared.arrays import FloatArray

PAPER_TABLE_I = {
    "source-1": (0.07, 0.09, 67.2),
    "source-2": (0.19, 0.10, 66.2),
    "source-3": (0.44, 0.12, 57.9),
    "source-4": (0.48, 0.14, 52.1),
    "source-5": (0.52, 0.25, 12.3),
}
"""ψ̂*, e_rms in m and error reduction in % of each source: Sorocky, Zhou and Schoellig (2020),
Table I."""


def evaluation_table(result: EvaluationResult) -> Table:
    """Return a table of each inverse's tracking errors, the closest source first."""
    unit = f"m{result.unit}"
    table = Table(title=f"{result.target}, {result.architecture} inverses", title_justify="left")
    table.add_column("prior", no_wrap=True)
    over_axes = any(source.ranked is not None for source in result.sources)
    if over_axes:
        table.add_column("ψ*, all axes", justify="right")
    blank = ("",) if over_axes else ()
    # The paper's algorithm takes all axes for the first one, as predictions did in older results.
    first = ", 1st axis" if over_axes else ""
    predicted_first = first if len(result.predicted_axes) < 2 else ""
    for heading in (
        f"ψ̂*{first}",
        "± σ",
        f"expected {unit}{predicted_first}",
        f"RMS {unit}",
        "less error",
        "worst / baseline",
        "withdrawn",
    ):
        table.add_column(heading, justify="right")
    own = result.baseline
    expected = _predicted(own.predicted_rms_m)
    table.add_row("baseline", *blank, "", "", expected, _milli(own.rms_m), "", "", "")
    for name, found in (
        (NO_PRIOR, result.no_prior),
        (OWN, result.own),
        (MIXTURE, result.mixture),
        (BY_AXIS, result.by_axis),
    ):
        if found is not None:
            left = _predicted(found.predicted_rms_m) if isinstance(found, ByAxisResult) else ""
            table.add_row(name, *blank, "", "", left, *_cells(found))
    for place, source in enumerate(result.sources):
        ranked = "" if source.ranked is None else f"{source.ranked.psi:.3f}{source.ranked.on_axis}"
        table.add_row(
            source.robot,
            *(ranked for _ in blank),
            f"{source.psi:.3f}",
            "<0.001" if source.psi_std < 0.0005 else f"{source.psi_std:.3f}",
            _predicted(source.predicted_rms_m),
            *_cells(source),
            style="bold green" if place == 0 else None,
        )
    over = "ψ* over all axes" if over_axes else "ψ̂*"
    table.caption = (
        f"Kendall's τ with the error: {_or_dash(result.kendall_tau)} for {over}, "
        f"{_or_dash(result.kendall_tau_trajectory)} for the error predicted for these paths"
        f"{' from the first axis alone' if predicted_first else ''}"
        f"{_one_or_each(result)}{_least_expected(result)}"
    )
    table.caption_justify = "left"
    return table


def _one_or_each(result: EvaluationResult) -> str:
    """Return what one source for all axes left, beside the closest on each axis."""
    ranking = [source.ranked for source in result.sources if source.ranked is not None]
    if not ranking:
        return ""
    if result.by_axis is None:
        differ = sources_by_axis(ranking)
        if not differ:
            return f"\nno axis has a closer source than {result.selected}, beyond doubt"
        return (
            f"\naxes differ in their closest source, {in_words(differ, ranking)}, but the target "
            "cannot hold all of these at a time: name fewer sources to fly with that of each axis"
        )
    one, unit = result.sources[0], f"m{result.unit}"
    each = ", ".join(f"{source} on {axis}" for axis, source in result.by_axis.sources.items())
    return (
        f"\none source for all axes, {one.robot}: {error_cell(one)} {unit}{_expected(one)}; the "
        f"closest on each axis, {each}: {error_cell(result.by_axis)} {unit}"
        f"{_expected(result.by_axis)}"
    )


def _expected(one: SourceResult | ByAxisResult) -> str:
    return "" if one.predicted_rms_m is None else f" (expected {_predicted(one.predicted_rms_m)})"


def _least_expected(result: EvaluationResult) -> str:
    """Return what was left by the experience that the tests expect the least error of."""
    least, regret_m = result.least_expected, result.least_expected_regret_m
    if least is None or (len(result.sources) < 2 and result.by_axis is None):
        return ""
    said = f"\nthe tests expect the least error of {least}"
    if regret_m is None:
        return said
    return f"{said}, which left {_milli(regret_m)} m{result.unit} more than the least"


def ways_table(result: EvaluationResult) -> Table:
    """Return a table of every way to fly, after the tests alone and after more own flying."""
    unit = f"m{result.unit}"
    table = Table(title=f"{result.target}: which way to fly", title_justify="left")
    table.add_column("way", no_wrap=True)
    for heading in ("own flying, s", f"expected {unit}", f"RMS {unit}", "less error", "withdrawn"):
        table.add_column(heading, justify="right")
    for way in result.ways:
        low, high = _predicted(way.predicted_low_m), _predicted(way.predicted_high_m)
        table.add_row(
            way.way,
            f"{way.own_flight_s:.0f}",
            f"{_predicted(way.predicted_rms_m)} ({low} to {high})" if low else "",
            error_cell(way),
            "" if way.reduction_percent is None else f"{way.reduction_percent:.1f} %",
            str(way.taken_back),
            style="bold green" if way.way == result.chosen_way and not way.own_flight_s else None,
        )
    table.caption = "\n".join(_choices(result))
    table.caption_justify = "left"
    return table


def _choices(result: EvaluationResult) -> list[str]:
    lines = [
        f"after {point.own_flight_s:.0f} s: the predictions choose {point.chosen_way}, "
        f"{_milli(point.regret_m)} m{result.unit} above the best"
        for point in result.points
        if point.chosen_way is not None
    ]
    flights = sum(each.flights for each in result.coverage.values())
    if flights:
        inside = sum(each.inside for each in result.coverage.values())
        lines.append(f"{inside} of {flights} errors lay in the interval predicted for them (90 %)")
    lines.append(f"{result.worse_than_baseline} flights were worse than the baseline")
    return lines


def paper_table(result: EvaluationResult) -> Table:
    """Return a table that compares an evaluation with the paper's Table I.

    It makes sense only for the fleet that models the paper's quadrotors; sources that the paper
    does not name are left out.
    """
    table = Table(title="comparison with Table I of the paper", title_justify="left")
    table.add_column("prior", no_wrap=True)
    for heading in ("ψ̂*", "paper", "RMS, mm", "paper", "less error", "paper"):
        table.add_column(
            heading, justify="right", no_wrap=True, style="dim" if heading == "paper" else None
        )
    for source in result.sources:
        if source.robot in PAPER_TABLE_I:
            psi, rms_m, less = PAPER_TABLE_I[source.robot]
            reduction = source.reduction_percent
            table.add_row(
                source.robot,
                f"{source.psi:.2f}",
                f"{psi:.2f}",
                _milli(source.rms_m),
                f"{1000 * rms_m:.0f}",
                "" if reduction is None else f"{reduction:.1f} %",
                f"{less:.1f} %",
            )
    return table


def pairs_table(result: PairsResult) -> Table:
    """Return a table of all pairs' errors relative to the target's baseline, with a summary."""
    targets = [target.target for target in result.targets]
    table = Table(title="error relative to the baseline (ψ̂*)", title_justify="left")
    table.add_column("target")
    for robot in targets:
        table.add_column(f"from {robot}", justify="right")
    cells = {
        (pair.target, pair.source): f"{'-' if pair.ratio is None else f'{pair.ratio:.2f}'} "
        f"({pair.psi:.2f})"
        for pair in result.pairs
    }
    for target in targets:
        table.add_row(target, *(cells.get((target, source), "") for source in targets))
    table.caption = (
        f"Kendall's τ for ψ̂*, mean over targets: {_or_dash(result.kendall_tau)}, over all pairs: "
        f"{_or_dash(result.kendall_tau_pooled)}; for the error predicted for the paths: "
        f"{_or_dash(result.kendall_tau_trajectory)} and "
        f"{_or_dash(result.kendall_tau_trajectory_pooled)}; best source selected for "
        f"{result.best_selected} of {len(targets)} targets; {_regret(result)}worse than the "
        f"baseline on at least one path: {result.harmful} of {len(result.pairs)} pairs"
        f"{_chosen_ways(result)}"
    )
    table.caption_justify = "left"
    return table


def write_figures(folder: Path, record: EvaluationRecord, flights: Path) -> None:
    """Draw the paper's Figs. 4 and 7, the errors against own flying, and the paths flown.

    Args:
        folder: Folder of the run; the figures go to its subfolder `plots`.
        record: Results of the evaluation.
        flights: Parquet data set that holds every sample of every flight (see `FlightTable`). The
            picture of the paths is left out when it is missing.
    """
    plots = folder / "plots"
    plots.mkdir(exist_ok=True)
    fig4(plots / "fig4_psi_over_studies.png", record.studies)
    errors = [
        FlightError(
            prior=flight.inverse,
            drawing=flight.drawing,
            speed_m_s=flight.speed_m_s,
            rms_error_m=math.inf if flight.rms_m is None else flight.rms_m,
            taken_back=flight.taken_back is not None,
        )
        for flight in record.flights
        if flight.beyond_tests_s == 0
    ]
    fig7(plots / "fig7_errors.png", errors)
    error_curve(plots / "curve.png", record.result)
    flown = _flown(flights, errors, record.result.unit)
    if flown:
        paths(plots / "paths.png", flown)


def write_scatter(folder: Path, result: PairsResult) -> None:
    """Draw the predicted distance of every pair against the error it flew with.

    Args:
        folder: Folder of the run; the figure goes to its subfolder `plots`.
        result: All ordered pairs of robots.
    """
    plots = folder / "plots"
    plots.mkdir(exist_ok=True)
    scatter(plots / "pairs.png", transfer_pairs(result.pairs))


def _flown(table: Path, errors: list[FlightError], unit: str) -> list[FlownPath]:
    """Return the flights at the fastest speed, read from the table of samples.

    Only the first two axes are read; there are no paths for a robot with a single axis.
    """
    import pyarrow.compute as pc
    import pyarrow.parquet as pq

    if not table.exists():
        return []
    rows = pq.read_table(table)
    axes = rows["axis"].unique().to_pylist()
    fastest = max(error.speed_m_s for error in errors)
    flown = []
    for error in (e for e in errors if e.speed_m_s == fastest):
        label = flight_label(error.prior, path_label(error.drawing, error.speed_m_s, unit))
        mine = rows.filter(pc.equal(pc.cast(rows["flight"], "string"), label))
        columns: dict[str, list[FloatArray]] = {"desired": [], "actual": []}
        for axis in axes[:2]:
            one = mine.filter(pc.equal(pc.cast(mine["axis"], "string"), axis))
            for name, values in columns.items():
                values.append(np.asarray(one[name]))
        if len(axes) >= 2 and len(columns["desired"][0]):
            flown.append(
                FlownPath(
                    error=error,
                    desired_m=np.stack(columns["desired"], axis=1),
                    actual_m=np.stack(columns["actual"], axis=1),
                )
            )
    return flown


def _cells(result: InverseResult) -> tuple[str, str, str, str]:
    less = result.reduction_percent
    worst = result.worst_ratio
    return (
        error_cell(result),
        "" if less is None else f"{less:.1f} %",
        "" if worst is None else f"{worst:.2f}",
        str(result.taken_back),
    )


def error_cell(result: InverseResult) -> str:
    """Return a mean error in thousandths of its unit, or why there is none."""
    return f"{result.not_flown} not flown" if result.not_flown else _milli(result.rms_m)


def _milli(value: float | None, without: str = "not finished") -> str:
    # Errors of one table may differ by factors of a thousand.
    return without if value is None else f"{1000 * value:.3g}"


def _predicted(value: float | None) -> str:
    return _milli(value, without="")


def _regret(result: PairsResult) -> str:
    regret = result.regret
    if regret is None:
        return ""
    return (
        f"regret {regret.selected:.3f} of the baseline's error, {regret.random:.3f} for a random "
        "choice; "
    )


def _chosen_ways(result: PairsResult) -> str:
    chosen, coverage = result.chosen, result.coverage
    if chosen is None:
        return ""
    ways = ", ".join(f"{target} {way}" for target, way in chosen.ways.items())
    return (
        f"; the predictions choose: {ways}; regret of these {_or_dash(chosen.regret, 3)} of the "
        f"baseline's error on average, {_or_dash(chosen.regret_max, 3)} at worst; flights worse "
        "than the baseline: "
        f"{chosen.worse_than_baseline} with them, {result.worse_than_baseline} with any way; "
        f"{coverage.inside} of {coverage.flights} errors lay in their predicted interval (90 %)"
    )


def _or_dash(value: float | None, digits: int = 2) -> str:
    return "-" if value is None else f"{value:.{digits}f}"
