"""The work of `nufleet view`: find a recording or the live view, and open it."""

from __future__ import annotations

import threading
from pathlib import Path

import click

from nufleet.orchestrator.runs.folder import RECORDING, find_run
from nufleet.orchestrator.viewer.server.open import open_native, open_web
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT


def view_and_print(
    run: str | None, *, live: bool, web: bool, picture: Path | None, runs_root: Path
) -> None:
    """Open the recording of a run or the run in progress, or save a picture of a recording.

    Args:
        run: Name of the run, path of its folder, or `latest`; None for the latest.
        live: Whether to watch the run in progress on this machine instead.
        web: Whether to open it in a browser instead of a window; returns on Ctrl-C only.
        picture: File for a picture of the recording; None opens a viewer.
        runs_root: Folder that holds the folders of all runs.

    Raises:
        InvalidInputError: There is no such run, or it has no recording.
        NufleetError: The viewer is not installed or failed.
    """
    source = (
        f"rerun+http://127.0.0.1:{GRPC_PORT}/proxy"
        if live
        else find_run(runs_root, run or "latest") / RECORDING
    )
    if picture is not None:
        _save_picture(Path(source), picture)
    elif web:
        page = open_web(source)
        try:
            click.echo(f"{page.url}   (Ctrl-C ends it)", err=True)
            threading.Event().wait()
        finally:
            page.close()
    else:
        open_native(source)


def _save_picture(recording: Path, picture: Path) -> None:
    from nufleet.orchestrator.viewer.server.picture import screenshot

    for problem in screenshot(recording, picture):
        click.secho(f"not drawn: {problem}", fg="yellow", err=True)
    click.echo(f"wrote {picture}", err=True)
