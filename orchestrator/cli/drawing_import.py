"""`nufleet drawing import`: make a drawing that robots can track of a file."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import (
    PositiveNumber,
    drawing_robots_options,
    json_option,
    overwriting_option,
)


@click.command("import")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="NAME.csv",
    help="Where to store it.  [default: the file's name with .csv, in this folder]",
)
@click.option("--height", "height_m", type=PositiveNumber(), metavar="M", help="Scale it so high.")
@click.option("--width", "width_m", type=PositiveNumber(), metavar="M", help="Scale it so wide.")
@click.option("--center", is_flag=True, help="Put the middle of its extent at the origin.")
@click.option(
    "--spacing",
    "spacing_m",
    type=PositiveNumber(0.001, 1.0),
    default=0.02,
    show_default=True,
    metavar="M",
    help="Between the points that are stored.",
)
@overwriting_option
@drawing_robots_options
@json_option
def import_drawing(
    file: Path,
    out: Path | None,
    height_m: float | None,
    width_m: float | None,
    center: bool,
    spacing_m: float,
    force: bool,
    fleet_file: str | None,
    connect: str,
    fleet_name: str | None,
    robots: tuple[str, ...],
    as_json: bool,
) -> None:
    """Make a drawing of FILE: checked, scaled, evenly sampled, stored as CSV in metres.

    FILE is an SVG with one path, or a table with x and y in two columns. Without --height and
    --width a table keeps its size, and the longer side of an SVG becomes 2.4 m. Then it says how
    long the drawing is, how sharp its bends are, how long it takes at each speed, and whether
    robots may fly it.

    \b
    nufleet drawing import heart.svg --height 2 --center --fleet paper_linear
    nufleet track --target drone-7 --trajectory heart.csv
    """
    from orchestrator.cli.drawing_session import WhoFlies, output_file, print_document, say
    from orchestrator.console import stderr_console
    from shared.drawing_files import write_drawing
    from shared.drawing_import import import_points
    from shared.drawing_shape import resampled, resized

    points = resized(import_points(file), width_m=width_m, height_m=height_m, centred=center)
    path = output_file(out, f"{file.stem}.csv", force=force)
    points = resampled(points, spacing_m)
    console = stderr_console()
    described = WhoFlies(fleet_file, connect, fleet_name, robots).describe(console)
    write_drawing(path, points)
    report = say(console, path, points, described)
    console.print(f"track it with:  nufleet track --target NAME --trajectory {path}")
    print_document(report, as_json=as_json)
