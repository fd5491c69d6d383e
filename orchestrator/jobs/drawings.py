"""The work of `nufleet drawing draw`, `import` and `show`."""

from __future__ import annotations

import shlex
import webbrowser
from pathlib import Path
from typing import TypedDict, Unpack

import click

from nufleet.orchestrator.conduct.preflight import check_robots
from nufleet.orchestrator.drawings.page import SPEED_M_S, DrawingPage
from nufleet.orchestrator.drawings.picture import draw_picture
from nufleet.orchestrator.drawings.report import (
    DrawingReport,
    durations_table,
    refusals,
    report_of,
    shape_text,
)
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.jobs.terminal import stderr_console, stdout_console
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing, write_drawing
from nufleet.shared.paths.foreign_files import import_drawing
from nufleet.shared.paths.installed import find_drawing
from nufleet.shared.paths.shape import resampled, resized
from nufleet.shared.wire.messages import Description


class RobotOptions(TypedDict):
    """The robots whose limits count: those of a fleet file, of a running fleet, or none."""

    fleet_file: Path | None
    """Path of a fleet file; None for a running fleet."""
    connect: str
    """Endpoint of a running fleet."""
    fleet_name: str | None
    """Name of the running fleet; None when only one is running there."""
    robots: tuple[str, ...]
    """Names of the robots; empty for all robots of the fleet file, or for none."""


def draw_and_print(
    out: Path,
    *,
    extent_m: float,
    port: int,
    browser: bool,
    force: bool,
    as_json: bool,
    **robots: Unpack[RobotOptions],
) -> None:
    """Serve a page for drawing until the drawing is saved, and print the report on it.

    Args:
        out: File to write.
        extent_m: Distance from the middle of the paper, the origin, to its edges.
        port: Port of the page; 0 takes a free one.
        browser: Whether to open the page in the user's browser.
        force: Whether an existing file may be overwritten.
        as_json: Whether to print the report as JSON on stdout too.
        robots: The robots whose workspace the page shows, and whose limits count.

    Raises:
        InvalidInputError: The file exists, or it is not a CSV file.
        EndpointInUseError: The port is in use.
    """
    if out.suffix.lower() != ".csv":
        raise InvalidInputError(f"{out}: a drawing is stored as a .csv file")
    path = _output_file(out, str(out), force=force)
    console = stderr_console()
    described = _described(robots)
    limits = [one.spec.tracking for one in described if one.spec.tracking is not None]
    workspace_m = min((one.position_max for one in limits), default=None)
    speed_m_s = min((SPEED_M_S, *(one.speed_max for one in limits)))
    with DrawingPage(
        port,
        extent_m,
        lambda points: write_drawing(path, points),
        workspace_m=workspace_m,
        speed_m_s=speed_m_s,
    ) as page:
        console.print(f"draw at  {page.url}   (Ctrl-C ends without a drawing)")
        if browser:
            webbrowser.open(page.url)
        points = page.wait()
    report = report_of(path.stem, str(path), points, described)
    _print_report(report, str(path), as_json=as_json)


def import_and_print(
    file: Path,
    out: Path | None,
    *,
    width_m: float | None,
    height_m: float | None,
    centred: bool,
    spacing_m: float,
    force: bool,
    as_json: bool,
    **robots: Unpack[RobotOptions],
) -> None:
    """Import a drawing from a file, and print the report on it.

    Args:
        file: An SVG file, or a table with x and y in two columns.
        out: File to write; None for the name of `file` with `.csv`, in the working directory.
        width_m: Width to scale to; None keeps the proportions, or the size.
        height_m: Height to scale to; None keeps the proportions, or the size.
        centred: Whether to centre the bounding box on the origin.
        spacing_m: Distance between the points that are stored.
        force: Whether an existing file may be overwritten.
        as_json: Whether to print the report as JSON on stdout too.
        robots: The robots whose limits count.

    Raises:
        InvalidInputError: The file cannot be read or is no drawing, or `out` exists or is not a
            CSV file.
    """
    drawn = import_drawing(file)
    points = resized(drawn.points, width_m=width_m, height_m=height_m, centred=centred)
    path = _output_file(out, f"{file.stem}.csv", force=force)
    points = resampled(points, spacing_m)
    described = _described(robots)
    try:
        report = report_of(path.stem, str(path), points, described)
    except InvalidInputError as error:
        size = "give its size in m with --height or --width, if it has another unit"
        raise InvalidInputError(f"{file}: {error}; {size}") from error
    write_drawing(path, points)
    if drawn.ignored:
        stderr_console().print(
            f"not imported: {', '.join(drawn.ignored)}. A drawing is a curve in x and y; "
            "--speed of nufleet track sets how fast it is flown",
            markup=False,
        )
    _print_report(report, str(path), as_json=as_json)


def show_and_print(
    drawing: str,
    picture: Path | None,
    *,
    speed_m_s: float,
    force: bool,
    as_json: bool,
    **robots: Unpack[RobotOptions],
) -> None:
    """Draw a picture of a drawing, and print the report on it.

    Args:
        drawing: Name or path of the drawing.
        picture: File to write; None for the drawing's name with `.png`, in the working directory.
        speed_m_s: Largest speed along the path in the picture.
        force: Whether an existing file may be overwritten.
        as_json: Whether to print the report as JSON on stdout too.
        robots: The robots whose limits count.

    Raises:
        InvalidInputError: There is no such drawing, or the picture's file exists.
    """
    file = find_drawing(drawing)
    points = read_drawing(file)
    path = _output_file(picture, f"{file.stem}.png", force=force)
    if path.suffix.lower() != ".png":
        raise InvalidInputError(f"{path}: the picture is a PNG, so that its name ends with .png")
    described = _described(robots)
    draw_picture(path, file.stem, points, speed_m_s, described)
    report = report_of(file.stem, str(file), points, described)
    _print_report(report, drawing, as_json=as_json)
    stderr_console().print(f"picture: {path}")


def _described(chosen: RobotOptions) -> tuple[Description, ...]:
    """Return the robots' descriptions, which hold their limits; nothing moves."""
    fleet_file, robots = chosen["fleet_file"], chosen["robots"]
    if fleet_file is None and not robots:
        return ()
    choice = FleetChoice.given(fleet_file, chosen["connect"], chosen["fleet_name"])
    with choice.connection(stderr_console()) as (fleet, _, there):
        robots = robots or there
        check_robots(robots, there)
        return tuple(fleet.describe_all(robots).values())


def _output_file(wanted: Path | None, default: str, *, force: bool) -> Path:
    path = Path(default) if wanted is None else wanted
    if path.exists() and not force:
        raise InvalidInputError(f"{path} already exists: choose another --out, or give --force")
    return path


def _print_report(report: DrawingReport, trajectory: str, *, as_json: bool) -> None:
    """Print a report on stdout, and on stderr how `nufleet track` is given the drawing."""
    if as_json:
        click.echo(report.document())
    else:
        console = stdout_console()
        console.print(f"[bold]{report.drawing}[/]: {shape_text(report.shape)}")
        console.print(durations_table(report))
        for reason in (*refusals(report), *report.remarks):
            console.print(f"[yellow]{reason}[/]")
    hint = f"track it with:  nufleet track --target NAME --trajectory {shlex.quote(trajectory)}"
    if all(duration.reason is not None for duration in report.durations):
        hint = "none of these robots may fly it as it is"
    stderr_console().print(hint)
