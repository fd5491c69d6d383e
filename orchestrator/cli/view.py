"""`nufleet view`: open the recording of a run, or watch the one in progress."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import overwriting_option, refuse_in_vain, runs_option
from nufleet.orchestrator.cli.types import RunName


@click.command()
@click.argument("run", type=RunName(), required=False)
@click.option("--live", is_flag=True, help="Watch the run in progress, if it has --live.")
@click.option("--web", is_flag=True, help="Open it in a browser instead of the native viewer.")
@click.option(
    "--screenshot",
    "picture",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Save a picture (PNG) of the recording instead; needs no display.",
)
@overwriting_option
@runs_option
def view(run: str | None, live: bool, picture: Path | None, **options: Any) -> None:
    """Open the recording of RUN: a folder, its name, or `latest` (the default)."""
    if live and run is not None:
        raise click.UsageError("give either RUN or --live")
    if live:
        refuse_in_vain("with --live", "runs_root")
    if picture is not None:
        refuse_in_vain("with --screenshot", "web")
    if picture is None:
        refuse_in_vain("without --screenshot", "force")
    if live and picture is not None:
        raise click.UsageError("--screenshot takes a picture of a recording: omit --live")
    from nufleet.orchestrator.jobs.view import view_and_print

    view_and_print(run, live=live, picture=picture, **options)
