"""`nufleet view`: look at a run, or at the one that is running."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import runs_option


@click.command()
@click.argument("run", required=False)
@click.option("--live", is_flag=True, help="Watch the study that runs now with --live.")
@click.option("--web", is_flag=True, help="In a browser instead of the native viewer.")
@click.option(
    "--screenshot",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Write a picture (PNG) instead; needs no display.",
)
@runs_option
def view(run: str | None, live: bool, web: bool, screenshot: Path | None, runs_root: Path) -> None:
    """Open the recording of RUN: a folder, its name, or `latest` (the default)."""
    from orchestrator.run_folder import RECORDING, find_run
    from orchestrator.viewer.show import open_native, open_web, take_screenshot
    from orchestrator.viewer.writer import GRPC_PORT
    from shared.errors import InvalidInputError

    if live and run is not None:
        raise click.UsageError("name a run, or watch the running one with --live")
    if live:
        source = f"rerun+http://127.0.0.1:{GRPC_PORT}/proxy"
    else:
        recording = find_run(runs_root, run or "latest") / RECORDING
        if not recording.exists():
            raise InvalidInputError(f"{recording} is missing: that run was not recorded")
        source = str(recording)
    if screenshot is not None:
        take_screenshot(source, screenshot)
        click.echo(f"wrote {screenshot}", err=True)
    elif web:
        open_web(source)
    else:
        open_native(source)
