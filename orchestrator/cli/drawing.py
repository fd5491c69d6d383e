"""The commands `nufleet drawing draw`, `import`, `list` and `show`."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.orchestrator.cli.options import (
    PositiveNumber,
    drawing_robots_options,
    json_option,
    overwriting_option,
)


@click.command()
@click.option(
    "--out",
    type=click.Path(dir_okay=False, path_type=Path),
    default=Path("drawing.csv"),
    show_default=True,
    metavar="NAME.csv",
    help="Where the drawing is stored.",
)
@click.option(
    "--extent",
    "extent_m",
    type=click.FloatRange(0.1, 100.0),
    default=1.3,
    show_default=True,
    metavar="M",
    help="How far the paper reaches from its middle, the origin.",
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=0,
    help="Where the page is served, on this machine alone.  [default: a free one]",
)
@click.option("--browser", is_flag=True, help="Open the page in the browser.")
@overwriting_option
@json_option
def draw(out: Path, extent_m: float, port: int, browser: bool, force: bool, as_json: bool) -> None:
    """Serve a page on this machine to draw on with a mouse, a pen or a finger.

    It prints the page's address, and ends when the drawing is saved, or by Ctrl-C.

    \b
    nufleet drawing draw --out loop.csv
    nufleet track --target drone-7 --trajectory loop.csv
    """
    import webbrowser

    from nufleet.orchestrator.drawings.page import DrawingPage
    from nufleet.orchestrator.jobs.drawings import output_file, print_document, say
    from nufleet.orchestrator.runs.console import stderr_console
    from nufleet.shared.errors import InvalidInputError
    from nufleet.shared.paths.files import write_drawing

    if out.suffix.lower() != ".csv":
        raise InvalidInputError(f"{out}: a drawing is stored as a .csv file")
    path = output_file(out, str(out), force=force)
    console = stderr_console()
    with DrawingPage(port, extent_m, lambda points: write_drawing(path, points)) as page:
        console.print(f"draw at  {page.url}   (Ctrl-C ends without a drawing)")
        if browser:
            webbrowser.open(page.url)
        points = page.wait()
    report = say(console, path, points, ())
    console.print(f"track it with:  nufleet track --target NAME --trajectory {path}")
    print_document(report, as_json=as_json)


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
    from nufleet.orchestrator.jobs.drawings import WhoFlies, output_file, print_document, say
    from nufleet.orchestrator.runs.console import stderr_console
    from nufleet.shared.paths.files import write_drawing
    from nufleet.shared.paths.foreign_files import import_points
    from nufleet.shared.paths.shape import resampled, resized

    points = resized(import_points(file), width_m=width_m, height_m=height_m, centred=center)
    path = output_file(out, f"{file.stem}.csv", force=force)
    points = resampled(points, spacing_m)
    console = stderr_console()
    described = WhoFlies(fleet_file, connect, fleet_name, robots).describe(console)
    write_drawing(path, points)
    report = say(console, path, points, described)
    console.print(f"track it with:  nufleet track --target NAME --trajectory {path}")
    print_document(report, as_json=as_json)


@click.command("list")
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path(),
    show_default=True,
    help="Whose .csv and .svg drawings are listed besides those that are installed.",
)
@json_option
def list_drawings(folder: Path, as_json: bool) -> None:
    """List the drawings that --trajectory takes: installed ones by name, others by file."""
    import json

    from rich.table import Table

    from nufleet.orchestrator.runs.console import stderr_console
    from nufleet.shared.errors import InvalidInputError
    from nufleet.shared.paths.files import read_drawing
    from nufleet.shared.paths.installed import drawing_names, find_drawing
    from nufleet.shared.paths.shape import shape_of

    found = {name: find_drawing(name) for name in drawing_names()}
    files = sorted(p for p in folder.glob("*") if p.suffix.lower() in {".csv", ".svg"})
    found |= {str(path): path for path in files}
    table = Table()
    table.add_column("--trajectory")
    for heading in ("length, m", "width, m", "height, m", "tightest radius, m"):
        table.add_column(heading, justify="right")
    documents = []
    for name, path in found.items():
        try:
            shape = shape_of(read_drawing(path))
        except InvalidInputError:
            continue  # a table of something else
        radius = "straight"
        if shape.tightest_radius_m is not None:
            radius = f"{shape.tightest_radius_m:.3f}"
        table.add_row(
            name,
            f"{shape.length_m:.2f}",
            f"{shape.width_m:.2f}",
            f"{shape.height_m:.2f}",
            radius,
        )
        documents.append({"drawing": name, "shape": shape.model_dump(mode="json")})
    if as_json:
        click.echo(json.dumps({"schema": 1, "drawings": documents}))
    else:
        stderr_console().print(table)


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
    from nufleet.orchestrator.drawings.picture import draw_picture
    from nufleet.orchestrator.jobs.drawings import WhoFlies, output_file, print_document, say
    from nufleet.orchestrator.runs.console import stderr_console
    from nufleet.shared.paths.files import read_drawing
    from nufleet.shared.paths.installed import find_drawing

    file = find_drawing(drawing)
    points = read_drawing(file)
    picture = output_file(png, f"{file.stem}.png", force=force)
    console = stderr_console()
    described = WhoFlies(fleet_file, connect, fleet_name, robots).describe(console)
    report = say(console, file, points, described)
    draw_picture(picture, file.stem, points, speed_m_s)
    console.print(f"picture: {picture}")
    print_document(report, as_json=as_json)
