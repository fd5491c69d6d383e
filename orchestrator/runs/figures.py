"""How figures look: one style, and labels that keep clear of one another."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.shared.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#8C564B", "#7F7F7F")
"""The colour-blind-safe palette of Okabe and Ito, and two more."""

WITHOUT_SOURCE = {BASELINE: "#3C3C3C", NO_PRIOR: "#9C8FBF", OWN: "#8A6D3B", MIXTURE: "#2F8F6F"}

DPI = 130

_LABEL_GAP = 5.0


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


def label_places(points: FloatArray, sizes: FloatArray, area: tuple[float, float]) -> FloatArray:
    """Return the lower left corner of each label, shape (n, 2).

    Each in turn takes, of places all around its point, the one that covers least.

    Args:
        points: Places to label, in the units of the screen, shape (n, 2).
        sizes: Widths and heights of the labels, shape (n, 2).
        area: Width and height of the area for labels, whose corner is the origin.
    """
    taken = np.empty((0, 4))
    marks = np.column_stack([points - _LABEL_GAP / 2, points + _LABEL_GAP / 2])
    corners = []
    for point, size in zip(points, sizes, strict=True):
        candidates = point + _around(size)
        boxes = np.column_stack([candidates, candidates + size])
        covered = _overlap(boxes, taken).sum(axis=1) + 2 * _overlap(boxes, marks).sum(axis=1)
        outside = np.maximum(-boxes[:, :2], 0).sum(axis=1)
        outside += np.maximum(boxes[:, 2:] - np.array(area), 0).sum(axis=1)
        # Of places that are equally free the nearest, which come first.
        far = 1e-3 * np.arange(len(candidates)) * size[1]
        best = int(np.argmin(covered + 1e3 * outside + far))
        taken = np.concatenate([taken, boxes[best : best + 1]])
        corners.append(candidates[best])
    return np.array(corners).reshape(-1, 2)


def _around(size: FloatArray) -> FloatArray:
    """Return the corners of labels beside, above and below a point, the best liked first."""
    width, height = size
    near = [
        (_LABEL_GAP, 0.0),
        (-width - _LABEL_GAP, 0.0),
        (-width / 2, height),
        (-width / 2, -height),
    ]
    beside = [
        (x, step * height)
        for step in (0.7, -0.7, 1.5, -1.5, 2.4, -2.4, 3.4, -3.4)
        for x in (_LABEL_GAP, -width - _LABEL_GAP, 3 * _LABEL_GAP, -width - 3 * _LABEL_GAP)
    ]
    return np.asarray(np.array([*near, *beside]) - np.array([0.0, height / 2]))


def _overlap(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """Return the areas that boxes (n, 4) have in common with others (m, 4), shape (n, m)."""
    low = np.maximum(boxes[:, np.newaxis, :2], others[np.newaxis, :, :2])
    high = np.minimum(boxes[:, np.newaxis, 2:], others[np.newaxis, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=2))
