"""What the commands `nufleet drawing ...` share: whose limits count, and what is printed."""

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
from nufleet.orchestrator.fleet.reach import Reach
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import find_fleet_file
from nufleet.shared.wire.messages import Description


@dataclass(frozen=True)
class WhoFlies:
    """The robots whose limits count: of a fleet file, of a running fleet, or none."""

    fleet_file: str | None
    connect: str
    fleet_name: str | None
    robots: tuple[str, ...]

    def describe(self, console: Console) -> tuple[Description, ...]:
        """Ask the robots for their limits; nothing moves."""
        if self.fleet_file is None and not self.robots:
            return ()
        file = None if self.fleet_file is None else str(find_fleet_file(self.fleet_file))
        reach = Reach(connect=self.connect, fleet_name=self.fleet_name, fleet_file=file)
        with reach.connection(console) as (fleet, _, there):
            robots = self.robots or there
            check_robots(robots, there)
            return tuple(fleet.describe(robot) for robot in robots)


def output_file(wanted: Path | None, default: str, *, force: bool) -> Path:
    """Return where to write; raises InvalidInputError when something is there already."""
    path = Path(default) if wanted is None else wanted
    if path.exists() and not force:
        raise InvalidInputError(f"{path} is there already: choose another --out, or --force")
    return path


def say(
    console: Console, path: Path, points: FloatArray, robots: tuple[Description, ...]
) -> DrawingReport:
    """Print what is to be known of a drawing, and return it."""
    report = report_of(path.stem, str(path), points, robots)
    console.print(f"[bold]{path.stem}[/]: {shape_text(report.shape)}")
    console.print(durations_table(report))
    for reason in refusals(report):
        console.print(f"[yellow]{reason}[/]")
    return report


def print_document(report: DrawingReport, *, as_json: bool) -> None:
    """Print the one document, when it was asked for."""
    if as_json:
        click.echo(report.document())
