"""`nufleet drawing list`: which drawings there are."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import json_option


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

    from orchestrator.console import stderr_console
    from shared.drawing_files import read_drawing
    from shared.drawing_shape import shape_of
    from shared.drawings import drawing_names, find_drawing
    from shared.errors import InvalidInputError

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
