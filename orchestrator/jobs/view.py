"""The work of `nufleet view`: find a recording or the live view, and open it."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import click

from nufleet.orchestrator.runs.folder import RECORDING, find_run
from nufleet.orchestrator.viewer.server.open import open_native, open_web
from nufleet.orchestrator.viewer.server.ports import GRPC_PORT
from nufleet.shared.errors import InvalidInputError


def view_and_print(
    run: str | None,
    *,
    live: bool,
    web: bool,
    picture: Path | None,
    force: bool,
    runs_root: Path,
) -> None:
    """Open the recording of a run or the run in progress, or save a picture of a recording.

    Args:
        run: Name of the run, path of its folder, or `latest`; None for the latest.
        live: Whether to watch the run in progress on this machine instead.
        web: Whether to open it in a browser instead of a window; returns on Ctrl-C only.
        picture: File for a picture of the recording; None opens a viewer.
        force: Whether an existing file may be overwritten by the picture.
        runs_root: Folder that holds the folders of all runs.

    Raises:
        InvalidInputError: There is no such run, or it has no recording.
        NufleetError: The viewer is not installed or failed.
    """
    source = (
        f"rerun+http://127.0.0.1:{GRPC_PORT}/proxy"
        if live
        else _recording(find_run(runs_root, run or "latest"))
    )
    if live and not _is_served(GRPC_PORT):
        click.echo("no run is live yet: start one with --live, and it will be shown", err=True)
    if picture is not None:
        if picture.suffix.lower() != ".png":
            raise InvalidInputError(f"{picture}: a picture is a PNG, so its name ends with .png")
        if picture.exists() and not force:
            raise InvalidInputError(f"{picture} already exists: choose another, or give --force")
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


def _recording(folder: Path) -> Path:
    recording = folder / RECORDING
    if not recording.exists():
        raise InvalidInputError(
            f"{folder.name} has no recording; `nufleet runs show {folder.name}` prints its results"
        )
    return recording


def _is_served(port: int) -> bool:
    with socket.socket() as probe:
        return probe.connect_ex(("127.0.0.1", port)) == 0


def _save_picture(recording: Path, picture: Path) -> None:
    from nufleet.orchestrator.viewer.server.picture import screenshot

    for problem in screenshot(recording, picture):
        click.secho(f"not drawn: {problem}", fg="yellow", err=True)
    click.echo(f"wrote {picture}", err=True)
