"""A picture of a drawing: the path as a robot would travel it, coloured by speed."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

import numpy as np

from nufleet.orchestrator.drawings.report import ACCELERATION_MAX_M_S2, SAMPLE_TIME_S
from nufleet.orchestrator.flights.legs import trajectory
from nufleet.orchestrator.runs.figures import new_figure, plain, save
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.shape import shape_of
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import Description


def draw_picture(
    png: Path,
    name: str,
    points: FloatArray,
    speed: float,
    robots: Sequence[Description] = (),
) -> None:
    """Draw the path of a drawing, over the points as they were drawn.

    Args:
        png: File to write.
        name: Name of the drawing, for the title.
        points: Points of the drawing in m, shape (n, 2).
        speed: Largest speed on the path, in m/s.
        robots: Robots of which the first that may fly the path is shown; without one, the path is
            travelled within the default limits.
    """
    from matplotlib.collections import LineCollection

    who, path, sample_time_s = travelled(points, speed, robots)
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / sample_time_s
    figure = new_figure(6.5, 6.0)
    axes = figure.add_subplot()
    axes.plot(*points.T, color="0.75", lw=1.0, label="as drawn")
    line = LineCollection(
        list(np.stack([path[:-1], path[1:]], axis=1)), cmap="viridis", linewidths=2.0
    )
    line.set_array(speeds)
    axes.add_collection(line)
    axes.plot(*path[0], "o", color="#009E73", ms=8, label="start")
    axes.plot(*path[-1], "s", color="#D55E00", ms=7, label="end")
    figure.colorbar(line, ax=axes, shrink=0.8, label="speed [m/s]")
    axes.set_aspect("equal")
    axes.margins(0.06)
    plain(axes)
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(
        f"{name} at {speed:g} m/s{who}: {len(path) * sample_time_s:.1f} s for "
        f"{shape_of(points).length_m:.2f} m",
        loc="left",
        fontsize=10,
    )
    axes.legend(frameon=False, fontsize=8)
    save(figure, png)


def travelled(
    points: FloatArray, speed: float, robots: Sequence[Description]
) -> tuple[str, FloatArray, float]:
    """Return a path as it is travelled.

    Args:
        points: Points of the drawing in m, shape (n, 2).
        speed: Largest speed on the path, in m/s.
        robots: Robots of which the first that may fly the path does so; without one, the path is
            travelled within the default limits.

    Returns:
        Who travels it, in words; positions in x and y, shape (samples, 2); time between them in s.
    """
    for robot in robots:
        with suppress(InvalidInputError):
            path = trajectory(points, speed, robot.spec, robot.robot)
            plane = np.pad(path, ((0, 0), (0, 1)))[:, :2]
            return f" by {robot.robot}", plane, robot.spec.sample_time_s
    return "", travel(points, speed, ACCELERATION_MAX_M_S2, SAMPLE_TIME_S), SAMPLE_TIME_S
