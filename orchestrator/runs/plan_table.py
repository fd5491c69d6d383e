"""What robots would do, as tables."""

from __future__ import annotations

from rich.table import Table

from nufleet.orchestrator.flights.planned import Outlook, PlannedMotion


def plan_parts(outlook: Outlook) -> list[Table | str]:
    """Return a table of all motions, one of what they amount to for each robot, and what follows.

    The second table is left out where it would only repeat the first.
    """
    parts: list[Table | str] = [_motions(outlook)]
    if (
        any(motion.times > 1 for motion in outlook.motions)
        or len(outlook.motions) > len(outlook.robots)
        or any(robot.battery is not None for robot in outlook.robots)
    ):
        parts.append(_robots(outlook))
    if outlook.later:
        parts.append(outlook.later)
    return parts


def _motions(outlook: Outlook) -> Table:
    headings = ("s", "between", "travels", "at most /s", "/s²", "measured limits")
    title = f"{outlook.headline}; every motion begins and ends at rest at 0"
    table = Table("robot", "motion", *headings, title=title, title_justify="left")
    for one in outlook.motions:
        times = "" if one.times == 1 else f"≤ {one.times} × "
        table.add_row(
            one.robot if one.simulated else f"[bold]{one.robot}[/] (real)",
            one.what,
            f"{times}{one.duration_s:.1f}",
            _between(one),
            "-" if one.length is None else f"{one.length:.3g} {one.unit}",
            f"{one.velocity:.3g} {one.unit}",
            f"{one.acceleration:.3g} {one.unit}",
            _measured(one),
        )
    return table


def _between(motion: PlannedMotion) -> str:
    spans = []
    for axis, low in motion.low.items():
        high = motion.high[axis]
        span = f"±{high:.3g}" if high == -low else f"{low:.3g} to {high:.3g}"
        spans.append(f"{axis} {span}")
    return f"{', '.join(spans)} {motion.unit}"


def _measured(motion: PlannedMotion) -> str:
    found = []
    for axis, (low, high) in motion.measured.items():
        if low is not None or high is not None:
            least = "-∞" if low is None else f"{low:g}"
            most = "∞" if high is None else f"{high:g}"
            found.append(f"{axis} {least} to {most} {motion.unit}")
    return ", ".join(found) or "none"


def _robots(outlook: Outlook) -> Table:
    headings = ("moves, s, at most", "battery", "lasts, s", "uses of a full one")
    table = Table("robot", *headings, title="in all", title_justify="left")
    for one in outlook.robots:
        table.add_row(
            one.robot,
            f"{one.duration_s:.0f}",
            "-" if one.battery is None else f"{one.battery:.0%}",
            "-" if one.endurance_s is None else f"{one.endurance_s:.0f}",
            "-" if one.battery_used is None else f"{one.battery_used:.0%}",
        )
    return table
