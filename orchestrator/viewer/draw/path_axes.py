"""Draws the axes of a path that is seen from above. Imports Rerun."""

from __future__ import annotations

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.marks import labels_2d, lines_2d
from nufleet.orchestrator.viewer.draw.palette import GRID, QUIET, TEXT
from nufleet.orchestrator.viewer.draw.path_frame import PathAxes

PLOT = "tracking/plot"

METRES = f"{PLOT}/path"
"""Entity below which positions are in the unit of the axes; elsewhere in the plot they are in the
plot's own units."""


def draw_axes(
    stream: rr.RecordingStream, axes: PathAxes, names: tuple[str, ...], unit: str
) -> None:
    """Draw the grid, ticks and names of both axes, and transform the paths into their frame.

    Args:
        stream: Stream to draw on, with its time set.
        axes: Range and ticks of the axes.
        names: Names of the two axes, x and y.
        unit: Unit of the axes.
    """
    scale = axes.scale
    stream.log(METRES, rr.Transform3D(translation=[*axes.shift, 0.0], scale=[scale, -scale, 1.0]))
    low, high = axes.place(np.array([axes.low, axes.high]))
    right, top = float(high[0]), float(high[1])
    left, bottom = float(low[0]), float(low[1])
    along = [(tick, float(axes.place(np.array([[tick, 0.0]]))[0, 0])) for tick in axes.ticks(0)]
    up = [(tick, float(axes.place(np.array([[0.0, tick]]))[0, 1])) for tick in axes.ticks(1)]
    lines = [[[x, bottom], [x, top]] for _, x in along]
    lines += [[[left, y], [right, y]] for _, y in up]
    frame = [[left, top], [left, bottom], [right, bottom]]
    stream.log(f"{PLOT}/grid", lines_2d([*lines, frame], [GRID] * len(lines) + [QUIET], 0.5))
    # The viewer writes a text below its position.
    texts = [([x, bottom + 2.0], f"{tick:g}") for tick, x in along]
    texts += [([left - 9.0, y - 3.5], f"{tick:g}") for tick, y in up]
    x_name, y_name = (f"{name} [{unit}]" for name in names)
    texts += [([(left + right) / 2, bottom + 10.0], x_name), ([left - 9.0, top - 12.0], y_name)]
    stream.log(
        f"{PLOT}/labels",
        labels_2d([place for place, _ in texts], [text for _, text in texts], [TEXT]),
    )
