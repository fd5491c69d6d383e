"""The figures of an evaluation, modelled on those of the paper's Section VI."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.evaluation.results import StudyEstimates
from nufleet.orchestrator.evaluation.summaries import by_source, reduction
from nufleet.orchestrator.evaluation.transfer_scatter import scatter
from nufleet.orchestrator.evaluation.values import FlightError, FlownPath
from nufleet.orchestrator.flights.labels import (
    BASELINE,
    BY_AXIS,
    MIXTURE,
    NO_PRIOR,
    OWN,
    path_label,
)
from nufleet.orchestrator.runs.figures import new_figure, plain, prior_colours, save
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BOXED_MIN = 5
"""Smallest number of studies whose estimates have a box; fewer are drawn as dots."""

__all__ = ["fig4", "fig7", "paths", "scatter"]


def fig4(png: Path, studies: Sequence[StudyEstimates]) -> None:
    """Draw how ψ̂*_n scatters over repeated studies, at the second and at the last iteration.

    This corresponds to the paper's Fig. 4. Boxes span the quartiles and show the median; whiskers
    reach to the last value within 1.5 box lengths; dots are single studies, which have no box if
    they are few. Sources are sorted by the median of their last estimates.

    Args:
        png: File to write.
        studies: Estimates of repeated studies of one target; each study contributes its own last
            iteration.

    Raises:
        InvalidInputError: There are no studies.
    """
    if not studies:
        raise InvalidInputError("there are no studies to be drawn")
    second = by_source(study.second for study in studies)
    last = by_source(study.last for study in studies)
    sources = sorted(last, key=lambda source: float(np.median(last[source])))
    colours = prior_colours(sources)
    figure = new_figure(max(6.0, 1.5 + 1.1 * len(sources)))
    axes = figure.add_subplot()
    for place, source in enumerate(sources):
        _box(axes, place - 0.19, second.get(source, []), colours[source], bold=False)
        _box(axes, place + 0.19, last[source], colours[source], bold=True)
    axes.plot([], [], "s", ms=9, mfc="white", mec="0.4", label="iteration 2")
    axes.plot([], [], "s", ms=9, mfc="0.8", mec="0.4", mew=1.8, label="last iteration")
    plain(axes)
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(sources)), sources)
    axes.set_ylim(bottom=0.0)
    axes.set_ylabel(r"estimate $\hat{\psi}^*_n$")
    axes.set_title(
        f"estimated worst-case chordal distance to the target (studies: {len(studies)})",
        loc="left",
        fontsize=10,
    )
    axes.legend(frameon=False, fontsize=9)
    save(figure, png)


def _box(axes: Axes, place: float, values: list[float], colour: str, *, bold: bool) -> None:
    if len(values) < BOXED_MIN:
        face = colour if bold else "white"
        axes.plot([place] * len(values), values, "o", color=colour, mfc=face, ms=7)
        return
    width = 1.8 if bold else 1.0
    line = {"color": colour, "linewidth": width}
    axes.boxplot(
        [values],
        positions=[place],
        widths=0.3,
        showfliers=False,
        patch_artist=True,
        manage_ticks=False,
        boxprops={"facecolor": (colour, 0.3 if bold else 0.0), "edgecolor": colour, "lw": width},
        medianprops=line,
        whiskerprops=line,
        capprops=line,
    )
    across = place + 0.22 * (_spread(len(values)) - 0.5)
    axes.plot(across, values, ".", color=colour, ms=4, alpha=0.6, mew=0)


def fig7(png: Path, errors: Sequence[FlightError]) -> None:
    """Draw the RMS tracking error with each prior, grouped by speed.

    Bars are means over the drawings and dots are single drawings. The number above a bar is the
    change of the error against the baseline's, averaged over the drawings ("% Red." of the paper's
    Table I). Flights that were not finished are drawn at the upper edge.

    Args:
        png: File to write.
        errors: All flights of one target.

    Raises:
        InvalidInputError: There are no flights.
    """
    if not errors:
        raise InvalidInputError("there are no flights to be drawn")
    speeds = sorted({error.speed_m_s for error in errors})
    priors = _ordered(error.prior for error in errors)
    colours = prior_colours(priors)
    figure = new_figure(max(8.0, 2.0 + 0.5 * len(priors) * len(speeds)))
    axes = figure.add_subplot()
    top = 1.12 * max((e.rms_error_m for e in errors if math.isfinite(e.rms_error_m)), default=1.0)
    width = 0.84 / len(priors)
    for group, speed in enumerate(speeds):
        for k, prior in enumerate(priors):
            some = [e for e in errors if e.speed_m_s == speed and e.prior == prior]
            place = group + (k - (len(priors) - 1) / 2) * width
            _bar(axes, place, width, some, colours[prior], top)
            less = reduction([e for e in errors if e.speed_m_s == speed], prior)
            if less is not None and prior != BASELINE:
                highest = max(min(e.rms_error_m, top) for e in some)
                axes.annotate(
                    f"{-100 * less:+.0f} %".replace("-", "−"),
                    (place, highest),
                    xytext=(0, 4),
                    textcoords="offset points",
                    ha="center",
                    fontsize=6.5,
                    color="0.35",
                )
    for prior in priors:
        axes.bar([0], [0], color=colours[prior], label=prior)
    axes.plot([], [], ".", color="0.3", ms=7, label="one drawing")
    if any(error.taken_back for error in errors):
        axes.plot([], [], "x", color="0.3", ms=5, label="prior withdrawn")
    if any(math.isinf(error.rms_error_m) for error in errors):
        axes.plot([], [], "^", color="0.3", ms=6, label="not finished")
    plain(axes)
    axes.grid(visible=False, axis="x")
    axes.set_xticks(range(len(speeds)), [f"{speed:g} m/s" for speed in speeds])
    axes.set_ylim(0.0, 1.02 * top)
    axes.set_xlabel("largest speed on the path")
    axes.set_ylabel("RMS tracking error [m]")
    axes.set_title(
        "tracking error by source of the prior, and its change relative to the baseline",
        loc="left",
        fontsize=10,
    )
    axes.legend(frameon=False, fontsize=9, loc="upper left", bbox_to_anchor=(1.0, 1.0))
    save(figure, png)


def _bar(
    axes: Axes, place: float, width: float, errors: list[FlightError], colour: str, top: float
) -> None:
    finished = [e for e in errors if math.isfinite(e.rms_error_m)]
    if finished:
        mean = float(np.mean([e.rms_error_m for e in finished]))
        axes.bar([place], [mean], 0.86 * width, color=colour, alpha=0.55, lw=0)
    across = place + 0.5 * width * (_spread(len(errors)) - 0.5)
    for x, error in zip(across, errors, strict=True):
        mark = "x" if error.taken_back else "."
        if math.isinf(error.rms_error_m):
            mark = "^"
        axes.plot([x], [min(error.rms_error_m, top)], mark, color=colour, ms=5, mec=colour)


def paths(png: Path, flown: Sequence[FlownPath]) -> None:
    """Draw desired and actual paths: a row for each drawing and speed, a column for each prior.

    Args:
        png: File to write.
        flown: Flights of one target, with their paths in m.

    Raises:
        InvalidInputError: There are no flights.
    """
    if not flown:
        raise InvalidInputError("there are no flights to be drawn")
    rows = list(dict.fromkeys((f.error.drawing, f.error.speed_m_s) for f in flown))
    priors = _ordered(f.error.prior for f in flown)
    colours = prior_colours(priors)
    at = {(f.error.drawing, f.error.speed_m_s, f.error.prior): f for f in flown}
    tall = [_tallness(flown, row) for row in rows]
    figure = new_figure(0.7 + 1.75 * len(priors), 0.8 + sum(1.65 * t + 0.5 for t in tall))
    grid = figure.subplots(
        len(rows),
        len(priors),
        squeeze=False,
        sharex="row",
        sharey="row",
        height_ratios=tall,
    )
    for row, (drawing, speed) in enumerate(rows):
        for column, prior in enumerate(priors):
            axes = grid[row, column]
            axes.set_aspect("equal")
            axes.tick_params(labelsize=7, length=2, color="0.6")
            axes.locator_params(nbins=4)
            plain(axes)
            flight = at.get((drawing, speed, prior))
            if flight is not None:
                _path(axes, flight, colours[prior])
            if row == 0:
                axes.annotate(
                    prior,
                    (0.5, 1.0),
                    xytext=(0, 17),
                    xycoords="axes fraction",
                    textcoords="offset points",
                    ha="center",
                    fontsize=10,
                    color=colours[prior],
                )
            if column == 0:
                axes.set_ylabel(f"{path_label(drawing, speed)}\ny [m]", fontsize=8)
            if row == len(rows) - 1:
                axes.set_xlabel("x [m]", fontsize=8)
    figure.suptitle("desired (thin) and actual paths, RMS error", x=0.01, ha="left", fontsize=10)
    save(figure, png)


def _path(axes: Axes, flight: FlownPath, colour: str) -> None:
    axes.plot(*flight.desired_m.T, color="0.5", lw=0.8)
    axes.plot(*flight.actual_m.T, color=colour, lw=1.1)
    error = flight.error
    text = f"{1e3 * error.rms_error_m:.0f} mm" if math.isfinite(error.rms_error_m) else "unfinished"
    if error.taken_back:
        text += ", withdrawn"
    axes.set_title(text, fontsize=7.5, color="0.25", pad=3)


def _tallness(flown: Sequence[FlownPath], row: tuple[str, float]) -> float:
    """Return the height of a row's paths over their width, limited to [0.3, 2]."""
    points = [
        points
        for f in flown
        if (f.error.drawing, f.error.speed_m_s) == row
        for points in (f.desired_m, f.actual_m)
    ]
    width, height = np.ptp(np.concatenate(points), axis=0)
    return float(np.clip(height / max(width, 1e-9), 0.3, 2.0))


def _ordered(priors: Iterable[str]) -> list[str]:
    """Return each prior once: the flights without a source first, then the sources by name."""
    names = set(priors)
    alone = [name for name in (BASELINE, NO_PRIOR, OWN, MIXTURE, BY_AXIS) if name in names]
    return alone + sorted(names - set(alone))


def _spread(count: int) -> FloatArray:
    """Return `count` values in [0, 1) that fill it evenly for any count, shape (count,).

    They are the fractional parts of multiples of the golden ratio (Weyl's sequence), so that the
    dots of one group spread sideways without a random generator.
    """
    golden = (math.sqrt(5) - 1) / 2
    return np.asarray((0.5 + golden * np.arange(count)) % 1.0)
