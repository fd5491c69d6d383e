"""A picture of a drawing: the path as a robot would travel it, coloured by speed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from nufleet.orchestrator.drawings.report import ACCELERATION_MAX_M_S2, SAMPLE_TIME_S
from nufleet.orchestrator.runs.figures import new_figure, plain, save
from nufleet.shared.arrays import FloatArray
from nufleet.shared.paths.shape import shape_of
from nufleet.shared.paths.trajectories import travel


def draw_picture(png: Path, name: str, points: FloatArray, speed: float) -> None:
    """Draw the path of a drawing, over the points as they were drawn.

    Args:
        png: File to write.
        name: Name of the drawing, for the title.
        points: Points of the drawing in m, shape (n, 2).
        speed: Largest speed on the path, in m/s.
    """
    from matplotlib.collections import LineCollection

    path = travel(points, speed, ACCELERATION_MAX_M_S2, SAMPLE_TIME_S)
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / SAMPLE_TIME_S
    figure = new_figure(6.5, 6.0)
    axes = figure.add_subplot()
    axes.plot(*points.T, color="0.75", lw=1.0, label="as drawn")
    travelled = LineCollection(
        list(np.stack([path[:-1], path[1:]], axis=1)), cmap="viridis", linewidths=2.0
    )
    travelled.set_array(speeds)
    axes.add_collection(travelled)
    axes.plot(*path[0], "o", color="#009E73", ms=8, label="start")
    axes.plot(*path[-1], "s", color="#D55E00", ms=7, label="end")
    figure.colorbar(travelled, ax=axes, shrink=0.8, label="speed [m/s]")
    axes.set_aspect("equal")
    axes.margins(0.06)
    plain(axes)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(
        f"{name} at {speed:g} m/s: {len(path) * SAMPLE_TIME_S:.1f} s for "
        f"{shape_of(points).length_m:.2f} m",
        loc="left",
        fontsize=10,
    )
    axes.legend(frameon=False, fontsize=8)
    save(figure, png)
