"""`nufleet transfer`: transfer a source's experience to a target."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from nufleet.orchestrator.cli.options import (
    connect_options,
    json_option,
    repository_option,
    runs_option,
)


@click.command()
@connect_options
@click.option("--target", required=True, metavar="NAME", help="Who flies with it from now on.")
@click.option(
    "--source",
    metavar="NAME|best|none",
    help=(
        "Whose experience; `best` is what the latest ranking of this target selected; `none` "
        "takes the target's prior away."
    ),
)
@click.option(
    "--file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Instead of a source: a file that `nufleet train` left in its run.",
)
@click.option(
    "--architecture",
    type=click.Choice(["state", "preview"]),
    help="Which of the source's experiences.  [default: the only one it offers]",
)
@runs_option
@repository_option
@json_option
def transfer(
    connect: str,
    fleet_name: str | None,
    target: str,
    source: str | None,
    file: Path | None,
    architecture: Literal["state", "preview"] | None,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Give a target the experience of a source, as the prior mean of its online process.

    The experience is fetched from the source, or read from a file, checked to fit the target,
    installed there (size and sha256 verified, kept across restarts) and read back.

    \b
    nufleet transfer --target drone-7 --source best
    nufleet transfer --target drone-7 --file runs/.../experiences/drone-3-state.safetensors
    """
    if (source is None) == (file is None):
        raise click.UsageError("Whose experience? Give either --source or --file.")
    if file is not None and architecture is not None:
        raise click.UsageError("A file holds one experience: leave --architecture out.")
    from nufleet.orchestrator.jobs.transfer import TransferCommand, transfer_and_print

    transfer_and_print(
        TransferCommand(
            connect=connect,
            fleet_name=fleet_name,
            target=target,
            source=source,
            file=file,
            architecture=architecture,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )
