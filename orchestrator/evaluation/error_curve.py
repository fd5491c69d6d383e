"""The figure of the error against the seconds that the target has flown itself, way by way."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from nufleet.orchestrator.evaluation.results import EvaluationResult, WayResult
from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.runs.figures import new_figure, plain, prior_colours, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_COLOURS = prior_colours(()) | {"best source": "#0072b2", "worst source": "#d55e00"}
"""Colours of the lines. Which sources are the best and the worst differs between fleets that are
drawn side by side, so these two have colours of their own."""

_NOISE_SHARE = 0.05  # least noise that is drawn, as a share of the least error
_LINEAR_S = 5.0  # the first seconds are drawn to a linear scale, the later ones to a logarithmic


def error_curve(png: Path, result: EvaluationResult) -> None:
    """Draw the error of every way against the target's own flying; see `draw_curve`.

    Args:
        png: File to write.
        result: Evaluation of one target.
    """
    figure = new_figure(7.5, 4.6)
    axes = figure.add_subplot()
    draw_curve(axes, result)
    axes.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    axes.set_title(f"{result.target}: which way to fly", loc="left", fontsize=10)
    save(figure, png)


def draw_curve(axes: Axes, result: EvaluationResult) -> None:
    """Draw the error of every way against the target's own flying, beyond its tests.

    A way that does not depend on own flying is a horizontal line. Bands, and bars at 0 s for the
    horizontal lines, are the predicted intervals. The dotted line is the noise of the sensor. The
    best and the worst source are those that left the least and the most error.

    Args:
        axes: Axes to draw on.
        result: Evaluation of one target.
    """
    curves = curves_of(result)
    durations_s = sorted({way.own_flight_s for curve in curves.values() for way in curve})
    last_s = durations_s[-1] if durations_s else 0.0
    single = [name for name, curve in curves.items() if len(curve) == 1]
    for name, curve in curves.items():
        colour = _COLOURS[name]
        flown = [way for way in curve if way.rms_m is not None]
        if not flown:
            continue
        seconds, errors = [w.own_flight_s for w in flown], [1e3 * (w.rms_m or 0.0) for w in flown]
        label = _label(name, curve[0])
        if name in single:
            axes.axhline(errors[0], color=colour, lw=1.2, label=label)
            # Side by side, so that no bar hides another; negative values are beside 0 s.
            place = -0.35 * _LINEAR_S * (1 + single.index(name)) / len(single)
            _interval(axes, place, curve[0], colour)
        else:
            axes.plot(seconds, errors, "o-", color=colour, lw=1.6, ms=4, label=label)
            _band(axes, [w for w in flown if w.predicted_low_m is not None], colour)
    least_m = min((w.rms_m for w in result.ways if w.rms_m), default=0.0)
    # A sensor without noise still shows what little a smooth motion accelerates between samples.
    if result.noise_rms_m and result.noise_rms_m > _NOISE_SHARE * least_m:
        axes.axhline(1e3 * result.noise_rms_m, color="0.6", lw=1.0, ls=":", label="sensor noise")
    if any(way.predicted_rms_m is not None for curve in curves.values() for way in curve):
        axes.fill_between([], [], [], color="0.5", alpha=0.3, lw=0, label="predicted, 90 %")
    axes.set_xscale("symlog", linthresh=_LINEAR_S)
    axes.set_yscale("log")
    axes.set_xlim(-0.4 * _LINEAR_S, max(1.1 * last_s, _LINEAR_S))
    axes.set_xticks(durations_s, [f"{s:.0f}" for s in durations_s])
    axes.minorticks_off()
    low, high = axes.get_ylim()
    ticks = [t for t in (0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200, 500) if low < t < high]
    axes.set_yticks(ticks, [f"{t:g}" for t in ticks])
    axes.set_xlabel("own flying of the target, beyond its tests [s]")
    axes.set_ylabel(f"RMS tracking error [m{result.unit}]")
    plain(axes)


def curves_of(result: EvaluationResult) -> dict[str, list[WayResult]]:
    """Return the points of every line of the figure, by its name, in the order of the legend.

    Of the sources only the best and the worst in flight are included, and a single one as the best.
    """
    by_way: dict[str, list[WayResult]] = {}
    for way in result.ways:
        by_way.setdefault(way.way, []).append(way)
    lines = {name: by_way.get(name, []) for name in (BASELINE, NO_PRIOR)}
    flown = [
        curve
        for source in result.sources
        if (curve := by_way.get(source.robot)) and curve[0].rms_m is not None
    ]
    ordered: Sequence[list[WayResult]] = sorted(flown, key=lambda curve: curve[0].rms_m or 0.0)
    if len(ordered) > 1:
        lines["worst source"] = ordered[-1]
    if ordered:
        lines["best source"] = ordered[0]
    lines |= {name: by_way.get(name, []) for name in (MIXTURE, OWN)}
    return {name: curve for name, curve in lines.items() if curve}


def _label(name: str, way: WayResult) -> str:
    if not name.endswith("source"):
        return name
    # What flew on after a withdrawal was not the source.
    withdrawn = f", withdrawn {way.taken_back} ×" if way.taken_back else ""
    return f"{name} ({way.way}{withdrawn})"


def _interval(axes: Axes, place: float, way: WayResult, colour: str) -> None:
    if way.predicted_low_m is not None and way.predicted_high_m is not None:
        ends = [1e3 * way.predicted_low_m, 1e3 * way.predicted_high_m]
        axes.plot([place, place], ends, color=colour, lw=3, alpha=0.4, solid_capstyle="butt")


def _band(axes: Axes, ways: Sequence[WayResult], colour: str) -> None:
    axes.fill_between(
        [way.own_flight_s for way in ways],
        [1e3 * (way.predicted_low_m or 0.0) for way in ways],
        [1e3 * (way.predicted_high_m or 0.0) for way in ways],
        color=colour,
        alpha=0.18,
        lw=0,
    )
