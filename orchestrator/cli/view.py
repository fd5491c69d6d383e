"""`nufleet view`: open the recording of a run, or watch the one in progress."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.orchestrator.cli.options import runs_option


@click.command()
@click.argument("run", required=False)
@click.option("--live", is_flag=True, help="Watch the study that runs now with --live.")
@click.option("--web", is_flag=True, help="In a browser instead of the native viewer.")
@click.option(
    "--screenshot",
    "picture",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write a picture (PNG) of a recording instead; needs no display.",
)
@runs_option
def view(run: str | None, live: bool, web: bool, picture: Path | None, runs_root: Path) -> None:
    """Open the recording of RUN: a folder, its name, or `latest` (the default)."""
    import threading

    from nufleet.orchestrator.runs.folder import RECORDING, find_run
    from nufleet.orchestrator.viewer.server.open import open_native, open_web
    from nufleet.orchestrator.viewer.server.picture import screenshot
    from nufleet.orchestrator.viewer.server.ports import GRPC_PORT

    if live and run is not None:
        raise click.UsageError("name a run, or watch the running one with --live")
    if live and picture is not None:
        raise click.UsageError("a picture is taken of a recording: leave --live")
    source: Path | str
    if live:
        source = f"rerun+http://127.0.0.1:{GRPC_PORT}/proxy"
    else:
        source = find_run(runs_root, run or "latest") / RECORDING
    if picture is not None:
        problems = screenshot(Path(source), picture)
        for problem in problems:
            click.secho(f"not drawn: {problem}", fg="yellow", err=True)
        click.echo(f"wrote {picture}", err=True)
    elif web:
        page = open_web(source)
        try:
            click.echo(f"{page.url}   (Ctrl-C ends it)", err=True)
            threading.Event().wait()
        finally:
            page.close()
    else:
        open_native(source)
