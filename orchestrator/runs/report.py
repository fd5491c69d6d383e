"""The plots and the report in a run's folder."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.runs.figures import new_figure, plain, prior_colours, save
from nufleet.orchestrator.runs.rank_result import RankResult, RunRecord
from nufleet.orchestrator.runs.verdict_table import verdict_markdown
from nufleet.orchestrator.runs.way_table import way_markdown
from nufleet.orchestrator.study.interface import Curve
from nufleet.shared.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.ticker import Formatter

CURVES_DRAWN = 8
"""Largest number of sources in a plot; more would hide each other, so the closest are drawn."""


def write_plots(
    folder: Path,
    record: RunRecord,
    curves: tuple[Curve, ...],
    true_psi: Mapping[str, FloatArray],
) -> None:
    """Draw the distance curves as in the paper's Fig. 2, and the estimates over the iterations.

    Args:
        folder: Folder of the run.
        record: Results of the run.
        curves: Final belief about each source's ψ_n(ω).
        true_psi: True ψ_n on the grid of its curve, shape (grid,), for sources with known models.
    """
    plots = folder / "plots"
    plots.mkdir(exist_ok=True)
    colours = drawn_colours(record.result)
    drawings: dict[str, Callable[[Axes], None]] = {
        "psi_over_frequency.png": lambda axes: _draw_curves(
            axes, record.result, curves, true_psi, colours
        ),
        "psi_over_iterations.png": lambda axes: _draw_history(axes, record, colours),
    }
    for name, draw in drawings.items():
        figure = new_figure()
        axes = figure.add_subplot()
        draw(axes)
        plain(axes)
        axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
        save(figure, plots / name)


def drawn_colours(result: RankResult) -> dict[str, str]:
    """Return the colours of the sources that are drawn, the closest ones, by source.

    A source has its colour by its name, not by its place, so that it is the same in every figure.
    """
    colours = prior_colours(estimate.robot for estimate in result.ranking)
    drawn = [estimate.robot for estimate in result.ranking[:CURVES_DRAWN]]
    return {source: colours[source] for source in drawn}


def _plain_numbers() -> Formatter:
    """Return what labels a logarithmic axis between its decades, as few as fit, as 0.2 or 30."""
    from matplotlib.ticker import LogFormatter

    class Plain(LogFormatter):
        def __call__(self, x: float, pos: int | None = None) -> str:
            return f"{x:g}" if super().__call__(x, pos) else ""

    return Plain()


def _draw_curves(
    axes: Axes,
    result: RankResult,
    curves: tuple[Curve, ...],
    true_psi: Mapping[str, FloatArray],
    colours: Mapping[str, str],
) -> None:
    for curve in curves:
        if curve.source not in colours:
            continue
        colour, omega = colours[curve.source], curve.omega_rad_s
        axes.fill_between(omega, curve.low, curve.high, color=colour, alpha=0.15, linewidth=0)
        axes.plot(omega, curve.median, color=colour)
        axes.plot(curve.sampled_omega_rad_s, curve.sampled_psi, "o", color=colour, markersize=5)
        if curve.source in true_psi:
            axes.plot(omega, true_psi[curve.source], "--", color="black", linewidth=0.9)
    for row in sorted(result.ranking, key=lambda row: -row.psi):
        if row.robot in colours:
            label = f"{row.robot}  {row.psi:.3g}{row.on_axis}"
            axes.plot(
                *(row.omega_rad_s, row.psi), "D", color=colours[row.robot], label=label, mec="black"
            )
    if true_psi:
        axes.plot([], [], "--", color="black", linewidth=0.9, label="closed form")
    axes.set_xscale("log")
    axes.xaxis.set_major_formatter("{x:g}")
    axes.xaxis.set_minor_formatter(_plain_numbers())
    axes.set_xlim(*result.band_rad_s)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("ω [rad/s]")
    axes.set_ylabel(f"chordal distance ψ to {result.target}")
    title = "median, 95 % interval, tests (dots) and worst case ψ* (diamonds)"
    axes.set_title(title, loc="left", fontsize=10)


def _draw_history(axes: Axes, record: RunRecord, colours: Mapping[str, str]) -> None:
    for source, colour in colours.items():
        points = [
            (entry.iteration, estimate.psi, estimate.psi_low, estimate.psi_high)
            for entry in record.history
            for estimate in entry.ranking
            if estimate.robot == source
        ]
        iterations, psi, low, high = np.array(points).T
        axes.errorbar(
            *(iterations, psi, [psi - low, high - psi]),
            fmt="o-",
            color=colour,
            label=source,
            capsize=3,
            markersize=4,
        )
        if source in record.closed_form:
            axes.axhline(record.closed_form[source].psi, color=colour, linestyle=":", linewidth=1)
    axes.set_ylim(bottom=0.0)
    axes.set_xlabel("round")
    axes.set_ylabel("median of ψ* and 95 % interval")
    title = "worst-case chordal distance"
    if record.closed_form:
        title += " (dotted: closed form)"
    axes.set_title(title, loc="left", fontsize=10)
    axes.set_xticks([entry.iteration for entry in record.history])


def _certainty(result: RankResult) -> list[str]:
    """Return lines on the confidence, where it is estimated, and on the eliminated sources."""
    if result.confidence is None:
        return []
    why = f": {result.stopped_because}" if result.stopped_because else ""
    out = [f"- {source}: {reason}" for source, reason in (result.eliminated or {}).items()]
    told = ["", f"Probability of a correct selection: {result.confidence:.3f}{why}."]
    return [*told, "", "Eliminated sources:", "", *out] if out else told


def write_report(folder: Path, record: RunRecord, *, draws: bool = True) -> None:
    """Write `report.md`: the request and the result, in words and one table.

    Args:
        folder: Folder of the run.
        record: Results of the run.
        draws: Whether the run drew plots and a recording, which the report then names.
    """
    result = record.result
    low, high = result.band_rad_s
    lines = [
        f"# {folder.name}",
        "",
        (
            f"Target **{result.target}**, {record.axes_in_words}, band {low:g} to {high:g} rad/s, "
            f"{result.iterations} iterations, seed {record.seed}."
        ),
        "",
        (
            f"Selected source: **{result.selected}**, after {result.robot_time_s:.0f} robot-seconds"
            f" and {record.wall_time_s:.1f} s of wall time."
        ),
        *_certainty(result),
        "",
        "| source | ψ* | 95 % interval | at ω [rad/s] | largest measured | tests | closed form |",
        "|---|---|---|---|---|---|---|",
    ]
    for estimate in result.ranking:
        exact = record.closed_form.get(estimate.robot)
        lines.append(
            f"| {estimate.robot} | {estimate.psi:.4f} "
            f"| {estimate.psi_low:.4f} to {estimate.psi_high:.4f} | {estimate.omega_rad_s:.3f}"
            f"{estimate.decided} "
            f"| {estimate.measured} | {estimate.tests} "
            f"| {'' if exact is None else f'{exact.psi:.4f}'} |"
        )
    lines += [f"\n{robot} was left out: {reason}" for robot, reason in record.dropped.items()]
    lines += [
        f"\n{robot} needed no first test: {stored.counted} replaced it, measured from "
        f"{stored.measured_from} to {stored.measured_to}{stored.reservation}."
        for robot, stored in (result.stored or {}).items()
    ]
    lines += ["", *verdict_markdown(result), "", *way_markdown(result)]
    lines += [f"\n{finding}" for finding in result.findings]
    drawn = ["psi_over_frequency.png", "psi_over_iterations.png"] if draws else []
    lines += ["", *(f"![{name}](plots/{name})" for name in drawn)]
    recording = "Recording: `run.rrd`. " if draws else ""
    lines += [
        "",
        (
            f"Raw samples: `telemetry.parquet`. {recording}Resolved configuration and versions: "
            "`config.json`."
        ),
    ]
    (folder / "report.md").write_text("\n".join(lines) + "\n", encoding="utf-8")
