"""The work of `nufleet drawing list`."""

from __future__ import annotations

import json
from pathlib import Path

import click
from rich.table import Column, Table

from nufleet.orchestrator.jobs.terminal import stdout_console
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import drawing_names, find_drawing
from nufleet.shared.paths.shape import shape_of


def list_and_print(folder: Path, *, as_json: bool) -> None:
    """Print the installed drawings and those in a folder, with their sizes.

    Args:
        folder: Folder whose .csv and .svg files are listed if they are drawings.
        as_json: Whether to print the list as JSON on stdout instead of a table.
    """
    found = {name: find_drawing(name) for name in drawing_names()}
    files = sorted(p for p in folder.glob("*") if p.suffix.lower() in {".csv", ".svg"})
    found |= {str(path): path for path in files}
    headings = ("length, m", "width, m", "height, m", "tightest radius, m")
    table = Table("--trajectory", *(Column(one, justify="right") for one in headings))
    documents = []
    for name, path in found.items():
        try:
            shape = shape_of(read_drawing(path))
        except InvalidInputError:
            continue  # the file is a table of something else
        radius = shape.tightest_radius_m
        table.add_row(
            name,
            f"{shape.length_m:.2f}",
            f"{shape.width_m:.2f}",
            f"{shape.height_m:.2f}",
            "straight" if radius is None else f"{radius:.3f}",
        )
        documents.append({"drawing": name, "shape": shape.model_dump(mode="json")})
    if as_json:
        click.echo(json.dumps({"schema": 1, "drawings": documents}))
    else:
        stdout_console().print(table)
