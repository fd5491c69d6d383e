"""`nufleet transfer`: transfer a source's experience to a target."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import connect_options, rehearsal_option, storage_options


@click.command()
@connect_options
@click.option("--target", required=True, metavar="NAME", help="Robot that gets the experience.")
@click.option(
    "--source",
    metavar="NAME,...|all|best|none",
    help=(
        "Robot whose experience is transferred; several, or `all` that have one, become a mixture; "
        "`best` is the one that the latest ranking for this target selected; `none` removes the "
        "target's priors."
    ),
)
@click.option(
    "--file",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Experience file that `nufleet train` left in its run, instead of a source.",
)
@click.option(
    "--architecture",
    type=click.Choice(["state", "preview"]),
    help="Architecture of the source's experience.  [default: the only one it offers]",
)
@rehearsal_option
@storage_options
def transfer(**options: Any) -> None:
    """Give a target the experience of a source, as the prior mean of its online process.

    The experience is fetched from the source, or read from a file, and checked to fit the target.
    The target installs it, verified by size and sha256, and keeps it across restarts; then it is
    read back.

    \b
    nufleet transfer --target drone-7 --source best
    nufleet transfer --target drone-7 --source all
    nufleet transfer --target drone-7 --file runs/.../experiences/drone-3-state.safetensors
    """
    if (options["source"] is None) == (options["file"] is None):
        raise click.UsageError("give either --source or --file")
    if options["file"] is not None and options["architecture"] is not None:
        raise click.UsageError("a file holds only one experience: omit --architecture")
    from nufleet.orchestrator.jobs.transfer import TransferCommand, transfer_and_print

    transfer_and_print(TransferCommand(**options))
