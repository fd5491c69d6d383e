"""`nufleet drawing draw`: draw by hand, in a browser."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import json_option, overwriting_option


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

    from orchestrator.cli.drawing_session import output_file, print_document, say
    from orchestrator.console import stderr_console
    from orchestrator.drawing_page import DrawingPage
    from shared.drawing_files import write_drawing
    from shared.errors import InvalidInputError

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
