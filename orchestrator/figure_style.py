"""The look of all figures that are saved as files."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from orchestrator.flight_labels import BASELINE, NO_PRIOR

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C564B", "#7F7F7F")
"""The colour-blind-safe palette of Okabe and Ito, and two more."""

WITHOUT_SOURCE = {BASELINE: "#3C3C3C", NO_PRIOR: "#9C8FBF"}

DPI = 130


def new_figure(width: float = 8.0, height: float = 4.5) -> Figure:
    """Return an empty figure, in inches, that needs no display."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    FigureCanvasAgg(figure)
    return figure


def plain(axes: Axes) -> None:
    """Leave of the frame what helps to read it."""
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def save(figure: Figure, png: Path) -> None:
    """Write a figure."""
    figure.savefig(png, dpi=DPI)


def prior_colours(priors: Iterable[str]) -> dict[str, str]:
    """Return a colour for each who gave a prior; sources get theirs in the order of their names.

    So a source has the same colour in every figure about the same fleet.
    """
    sources = sorted({prior for prior in priors if prior not in WITHOUT_SOURCE})
    return WITHOUT_SOURCE | {s: COLOURS[k % len(COLOURS)] for k, s in enumerate(sources)}
