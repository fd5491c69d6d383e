"""`nufleet drawing show`: what a drawing looks like and what it asks of a robot."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import (
    PositiveNumber,
    drawing_robots_options,
    json_option,
    overwriting_option,
)


@click.command()
@click.argument("drawing", metavar="NAME|FILE")
@click.option(
    "--png",
    "--out",
    "png",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE.png",
    help="Where the picture goes.  [default: the drawing's name with .png, in this folder]",
)
@click.option(
    "--speed",
    "speed_m_s",
    type=PositiveNumber(),
    default=0.6,
    show_default=True,
    metavar="M_S",
    help="Of the picture: how fast the path is travelled where its bends allow that.",
)
@overwriting_option
@drawing_robots_options
@json_option
def show(
    drawing: str,
    png: Path | None,
    speed_m_s: float,
    force: bool,
    fleet_file: str | None,
    connect: str,
    fleet_name: str | None,
    robots: tuple[str, ...],
    as_json: bool,
) -> None:
    """Draw a picture of a drawing and say how long it takes and which robots may fly it.

    \b
    nufleet drawing show clover --fleet paper_linear
    """
    from orchestrator.cli.drawing_session import WhoFlies, output_file, print_document, say
    from orchestrator.console import stderr_console
    from orchestrator.drawing_picture import draw_picture
    from shared.drawing_files import read_drawing
    from shared.drawings import find_drawing

    file = find_drawing(drawing)
    points = read_drawing(file)
    picture = output_file(png, f"{file.stem}.png", force=force)
    console = stderr_console()
    described = WhoFlies(fleet_file, connect, fleet_name, robots).describe(console)
    report = say(console, file, points, described)
    draw_picture(picture, file.stem, points, speed_m_s)
    console.print(f"picture: {picture}")
    print_document(report, as_json=as_json)
