"""A picture of what robots would do: when each moves, and where."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from nufleet.orchestrator.flights.planned import Outlook, PlannedMotion
from nufleet.orchestrator.runs.figures import new_figure, plain, prior_colours, save

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Pair = tuple[float, float]


def draw_plan(picture: Path, outlook: Outlook) -> None:
    """Draw the motions of every robot over time, and the positions that they lead through.

    Args:
        picture: File to write; its suffix chooses the format.
        outlook: What the robots would do.
    """
    robots = list(dict.fromkeys(motion.robot for motion in outlook.motions))
    colours = prior_colours(robots)
    figure = new_figure(11.0, 2.4 + 0.45 * max(len(robots), 4))
    over_time, over_place = figure.subplots(1, 2)
    figure.suptitle(outlook.headline, x=0.01, ha="left", fontsize=10)
    _draw_times(over_time, outlook, robots, colours)
    if any(len(motion.low) > 1 for motion in outlook.motions):
        _draw_plane(over_place, outlook, colours)
    else:
        _draw_spans(over_place, outlook, robots, colours)
    save(figure, picture)


def _draw_times(axes: Axes, outlook: Outlook, robots: list[str], colours: dict[str, str]) -> None:
    for row, robot in enumerate(robots):
        begin_s = 0.0
        for motion in outlook.motions:
            if motion.robot != robot:
                continue
            lasts_s = motion.times * motion.duration_s
            # A motion that may be repeated less often is pale.
            solid = 0.9 if motion.times == 1 else 0.45
            axes.barh(row, lasts_s, left=begin_s, color=colours[robot], alpha=solid, ec="white")
            begin_s += lasts_s
    axes.set_xlabel("time that each robot moves, at most [s]")
    _name_rows(axes, robots)


def _draw_spans(axes: Axes, outlook: Outlook, robots: list[str], colours: dict[str, str]) -> None:
    """Draw from where to where each robot moves along its only axis."""
    for motion in outlook.motions:
        row = robots.index(motion.robot)
        for axis, low in motion.low.items():
            axes.barh(
                row, motion.high[axis] - low, left=low, height=0.3, color=colours[robots[row]]
            )
            for limit in motion.measured[axis]:
                if limit is not None:
                    axes.plot([limit, limit], [row - 0.3, row + 0.3], color="0.2", lw=1.5)
    axes.axvline(0.0, color="0.5", lw=0.8, ls=":")
    first = outlook.motions[0]
    (axis,) = first.low
    axes.set_xlabel(f"{axis} [{first.unit}]; black: limits on what is measured")
    _name_rows(axes, robots)


def _draw_plane(axes: Axes, outlook: Outlook, colours: dict[str, str]) -> None:
    """Draw paths in the plane of the first two axes, and boxes around what they may reach."""
    from matplotlib.patches import Rectangle

    names = list(max(outlook.motions, key=lambda motion: len(motion.low)).low)[:2]
    for motion in outlook.motions:
        colour = colours[motion.robot]
        corner, size = _box(motion, names)
        axes.add_patch(Rectangle(corner, *size, fill=False, ec=colour, ls="--", lw=0.8))
        if set(names) <= set(motion.low):
            columns = [list(motion.low).index(name) for name in names]
            points = [[point[column] for column in columns] for point in motion.path]
            if points:
                axes.plot(*zip(*points, strict=True), color=colour, lw=1.2)
    axes.plot(0.0, 0.0, "+", color="0.2", ms=9)
    axes.set_aspect("equal", adjustable="datalim")
    axes.autoscale_view()
    plain(axes)
    unit = outlook.motions[0].unit
    axes.set_xlabel(f"{names[0]} [{unit}]; dashed: what the reference may reach")
    axes.set_ylabel(f"{names[1]} [{unit}]")


def _box(motion: PlannedMotion, names: list[str]) -> tuple[Pair, Pair]:
    """Return the lower left corner and the size of the box that a motion may reach."""
    low_x, low_y = (motion.low.get(name, 0.0) for name in names)
    high_x, high_y = (motion.high.get(name, 0.0) for name in names)
    return (low_x, low_y), (high_x - low_x, high_y - low_y)


def _name_rows(axes: Axes, robots: list[str]) -> None:
    plain(axes)
    axes.set_yticks(range(len(robots)), robots)
    axes.set_ylim(len(robots) - 0.4, -0.6)
