"""The table of a fleet's robots with their current activity."""

from __future__ import annotations

from collections.abc import Iterable

from rich.table import Column, Table

from nufleet.orchestrator.fleet.robot_watch import HEARTBEAT_LOST_S, RobotWatch

_COLOURS = {"idle": "green", "running": "cyan", "resting": "blue", "stopped": "red", "fault": "red"}


def fleet_table(fleet: str, watches: Iterable[RobotWatch]) -> Table:
    """Return one row per robot: status, progress of its goal, flown time, and the reason."""
    headings = ("progress", "moved, s", "heard, s ago")
    numbers = [Column(one, justify="right") for one in headings]
    table = Table("robot", "status", "goal", *numbers, "reason", title=f"fleet {fleet}")
    table.title_justify = "left"
    for watch in watches:
        state = watch.state
        if state is None or not watch.alive:
            table.add_row(watch.robot, "[red]gone[/]" if state else "not heard yet")
            continue
        silent = watch.silent_s > HEARTBEAT_LOST_S
        colour = "red" if silent else _COLOURS[state.status]
        table.add_row(
            watch.robot,
            f"[{colour}]{'silent' if silent else state.status}[/]",
            state.goal_id or "",
            f"{100 * state.progress:.0f} %" if state.goal_id else "",
            f"{state.robot_time_s:.1f}",
            f"{watch.silent_s:.1f}",
            state.reason,
        )
    return table
