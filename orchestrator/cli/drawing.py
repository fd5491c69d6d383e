"""The commands `nufleet drawing draw`, `import`, `list` and `show`."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    drawing_robots_options,
    json_option,
    overwriting_option,
    refuse_robots_in_vain,
)
from nufleet.orchestrator.cli.types import PositiveNumber
from nufleet.shared.command_line import folder_option


@click.command()
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("drawing.csv"),
    show_default=True,
    metavar="NAME.csv",
    help="File for the drawing.",
)
@click.option(
    "--extent",
    "extent_m",
    type=PositiveNumber(0.1, 100.0, unit="m"),
    default=1.3,
    show_default=True,
    metavar="M",
    help="Distance from the middle of the paper, the origin, to its edges.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Port of the page, which only this machine can reach.  [default: a free one]",
)
@click.option("--browser", is_flag=True, help="Open the page in the browser.")
@overwriting_option
@drawing_robots_options
@json_option
def draw(**options: Any) -> None:
    """Serve a page on this machine to draw on with a mouse, a pen or, on a touch screen, a finger.

    Prints the page's address, and ends when the drawing is saved or with Ctrl-C. With --fleet or
    --robot the page shows how far the robots may go.

    \b
    nufleet drawing draw --out loop.csv --fleet paper_linear
    nufleet track --target drone-7 --trajectory loop.csv
    """
    refuse_robots_in_vain(options)
    from nufleet.orchestrator.jobs.drawings import draw_and_print

    draw_and_print(**options)


@click.command("import")
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="NAME.csv",
    help="File for the drawing.  [default: FILE's name with .csv, in this folder]",
)
@click.option("--height", "height_m", type=PositiveNumber(), metavar="M", help="Scale to height M.")
@click.option("--width", "width_m", type=PositiveNumber(), metavar="M", help="Scale to width M.")
@click.option("--center", "centred", is_flag=True, help="Centre its bounding box on the origin.")
@click.option(
    "--spacing",
    "spacing_m",
    type=PositiveNumber(0.001, 1.0),
    default=0.02,
    show_default=True,
    metavar="M",
    help="Distance between the points that are stored.",
)
@overwriting_option
@drawing_robots_options
@json_option
def import_drawing(**options: Any) -> None:
    """Import a drawing from FILE: checked, scaled, evenly sampled, stored as CSV in metres.

    FILE is an SVG with one path, or a table with x and y in two columns. Without --height and
    --width a table keeps its size, and the longer side of an SVG becomes 2.4 m. The report states
    the drawing's length, its sharpest bend, its duration at several speeds, and whether the robots
    may fly it.

    \b
    nufleet drawing import heart.svg --height 2 --center --fleet paper_linear
    nufleet track --target drone-7 --trajectory heart.csv
    """
    refuse_robots_in_vain(options)
    from nufleet.orchestrator.jobs.drawings import import_and_print

    import_and_print(**options)


@click.command("list")
@folder_option(
    "--folder",
    default=Path(),
    show_default=True,
    help="Folder whose .csv and .svg drawings are listed after the installed ones.",
)
@json_option
def list_drawings(folder: Path, as_json: bool) -> None:
    """List the drawings that --trajectory takes: installed ones by name, others by file."""
    from nufleet.orchestrator.jobs.drawing_list import list_and_print

    list_and_print(folder, as_json=as_json)


@click.command()
@click.argument("drawing", metavar="NAME|FILE")
@click.option(
    "--png",
    "--out",
    "picture",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.png",
    help="File for the picture.  [default: the drawing's name with .png, in this folder]",
)
@click.option(
    "--speed",
    "speed_m_s",
    type=PositiveNumber(),
    default=0.6,
    show_default=True,
    metavar="M_S",
    help="Largest speed along the path in the picture; bends may require less.",
)
@overwriting_option
@drawing_robots_options
@json_option
def show(**options: Any) -> None:
    """Draw a picture of a drawing, and report how long it takes and which robots may fly it.

    \b
    nufleet drawing show clover --fleet paper_linear
    """
    refuse_robots_in_vain(options)
    from nufleet.orchestrator.jobs.drawings import show_and_print

    show_and_print(**options)
