"""How figures look: one style, and labels that keep clear of one another."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.flights.colours import WITHOUT_SOURCE, robot_colours
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, system_errors_as

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


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
    """Write a figure.

    Raises:
        InvalidInputError: The file cannot be written.
    """
    with system_errors_as(InvalidInputError, f"{png}: cannot be written"):
        figure.savefig(png, dpi=DPI)


def prior_colours(priors: Iterable[str]) -> dict[str, str]:
    """Return the colour for figures of each who gives a prior; see `flights.colours`."""
    sources = [prior for prior in priors if prior not in WITHOUT_SOURCE]
    colours = WITHOUT_SOURCE | robot_colours(sources)
    return {name: "#{:02x}{:02x}{:02x}".format(*c.on_light) for name, c in colours.items()}


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
