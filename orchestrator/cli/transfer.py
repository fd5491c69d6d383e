"""`nufleet transfer`: hand a source's experience to a target."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from orchestrator.cli.options import connect_options, json_option, repository_option, runs_option


@click.command()
@connect_options
@click.option("--target", required=True, metavar="NAME", help="Who flies with it from now on.")
@click.option(
    "--source",
    required=True,
    metavar="NAME|best|none",
    help=(
        "Whose experience; `best` is what the latest ranking of this target selected; `none` "
        "takes the target's prior away."
    ),
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
    source: str,
    architecture: Literal["state", "preview"] | None,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Give a target the experience of a source, as the prior mean of its online process.

    The file is fetched from the source, checked to fit the target, installed there (size and sha256
    verified, kept across restarts) and read back.

    \b
    nufleet transfer --target drone-7 --source best
    """
    from orchestrator.cli.transfer_session import TransferCommand, transfer_and_print

    transfer_and_print(
        TransferCommand(
            connect=connect,
            fleet_name=fleet_name,
            target=target,
            source=source,
            architecture=architecture,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )
