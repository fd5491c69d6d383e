"""What robots would do, as a table, and the consent of a person before real robots do it."""

from __future__ import annotations

import sys

import click
from rich.console import Console
from rich.table import Table

from nufleet.orchestrator.conduct.first_round import StudyOutlook
from nufleet.shared.errors import InvalidInputError


def outlook_table(planned: StudyOutlook) -> Table:
    """Return one row per robot of the first round."""
    low, high = planned.band_rad_s
    axes = (
        f"axes {', '.join((planned.axis, *planned.also))}"
        if planned.also
        else f"axis {planned.axis}"
    )
    title = (
        f"first of at most {planned.rounds_max} rounds: {axes}, {low:g} to {high:g} "
        "rad/s; every test begins and ends at rest at 0"
    )
    headings = (
        "tones",
        "rad/s",
        "s",
        "within ±",
        "at most /s",
        "/s²",
        "measured limits",
        "battery",
    )
    table = Table("robot", *headings, title=title)
    table.title_justify = "left"
    for one in planned.first_round:
        limits = "none"
        if one.measured_min is not None or one.measured_max is not None:
            least = "-∞" if one.measured_min is None else f"{one.measured_min:g}"
            most = "∞" if one.measured_max is None else f"{one.measured_max:g}"
            limits = f"{least} to {most} {one.unit}"
        charge = "" if one.battery is None else f"{one.battery:.0%}"
        lasts = "" if one.endurance_s is None else f"{one.endurance_s:.0f} s"
        table.add_row(
            (one.robot if one.simulated else f"[bold]{one.robot}[/] (real)")
            + (f", {one.axis}" if planned.also else ""),
            str(one.tones),
            f"{one.omega_min_rad_s:.3g} to {one.omega_max_rad_s:.3g}",
            f"{one.duration_s:.1f}",
            f"{one.reach:.3g} {one.unit}",
            f"{one.velocity:.3g} {one.unit}",
            f"{one.acceleration:.3g} {one.unit}",
            limits,
            ", ".join(part for part in (charge, lasts) if part) or "-",
        )
    return table


def ask_consent(planned: StudyOutlook, console: Console) -> None:
    """Show what is planned and ask whether real robots may move; simulated ones always may.

    Raises:
        InvalidInputError: No person is at the terminal to be asked.
        click.Abort: The person declined.
    """
    real = dict.fromkeys(one.robot for one in planned.first_round if not one.simulated)
    if not real:
        return
    console.print(outlook_table(planned))
    who = ", ".join(real)
    if not sys.stdin.isatty():
        raise InvalidInputError(
            f"{who} would really move, and no person is at the terminal to be asked: give --yes, "
            "or --plan to see what would be done"
        )
    click.confirm(f"{who} will really move, and take off if they fly. Go on?", abort=True, err=True)
