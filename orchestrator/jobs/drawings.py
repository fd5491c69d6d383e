"""The work that the commands `nufleet drawing ...` share: robots' limits, files and reports."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.drawings.report import (
    DrawingReport,
    durations_table,
    refusals,
    report_of,
    shape_text,
)
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import find_fleet_file
from nufleet.shared.wire.messages import Description


@dataclass(frozen=True)
class WhoFlies:
    """The robots whose limits count: those of a fleet file, of a running fleet, or none."""

    fleet_file: str | None
    """Path or name of a fleet file; None for a running fleet."""
    connect: str
    """Endpoint of a running fleet."""
    fleet_name: str | None
    """Name of the fleet; None when only one is running there."""
    robots: tuple[str, ...]
    """Names of the robots; empty for all robots of the fleet file, or for none."""

    def describe(self, console: Console) -> tuple[Description, ...]:
        """Return the robots' descriptions, which hold their limits; nothing moves."""
        if self.fleet_file is None and not self.robots:
            return ()
        if self.fleet_file is None:
            choice = FleetChoice.running(self.connect, self.fleet_name)
        else:
            choice = FleetChoice.started(find_fleet_file(self.fleet_file))
        with choice.connection(console) as (fleet, _, there):
            robots = self.robots or there
            check_robots(robots, there)
            return tuple(fleet.describe_all(robots).values())


def output_file(wanted: Path | None, default: str, *, force: bool) -> Path:
    """Return the path to write to.

    Args:
        wanted: Path that the user gave; None for the default.
        default: Default path.
        force: Whether an existing file may be overwritten.

    Raises:
        InvalidInputError: The file exists, and `force` is not set.
    """
    path = Path(default) if wanted is None else wanted
    if path.exists() and not force:
        raise InvalidInputError(f"{path} is there already: choose another --out, or --force")
    return path


def say(
    console: Console, path: Path, points: FloatArray, robots: tuple[Description, ...]
) -> DrawingReport:
    """Print the report on a drawing, and return it.

    Args:
        console: Console to print on.
        path: File of the drawing.
        points: Points of the drawing in m, shape (n, 2).
        robots: Descriptions of the robots whose limits count; empty for the default limits.
    """
    report = report_of(path.stem, str(path), points, robots)
    console.print(f"[bold]{path.stem}[/]: {shape_text(report.shape)}")
    console.print(durations_table(report))
    for reason in refusals(report):
        console.print(f"[yellow]{reason}[/]")
    return report


def print_document(report: DrawingReport, *, as_json: bool) -> None:
    """Print the report as JSON on stdout, if wanted."""
    if as_json:
        click.echo(report.document())
