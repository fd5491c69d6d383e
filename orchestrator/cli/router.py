"""`nufleet router`: run the Zenoh router that connects a fleet."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.orchestrator.cli.options import open_option
from nufleet.orchestrator.cli.types import Endpoint


@click.command()
@click.option(
    "--listen",
    type=Endpoint(),
    multiple=True,
    envvar="NUFLEET_LISTEN",
    metavar="ENDPOINT",
    help=(
        "Endpoint to listen on, such as tcp/127.0.0.1:7448; may be repeated. "
        " [env: NUFLEET_LISTEN; default: tcp/127.0.0.1:7447]"
    ),
)
@click.option(
    "--connect",
    type=Endpoint(),
    multiple=True,
    metavar="ENDPOINT",
    help="Another router to link with, also while it is not there yet; may be repeated.",
)
@click.option(
    "--config",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="Zenoh configuration (JSON5) instead, such as `nufleet fleet init` writes.",
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
@open_option
def router(
    listen: tuple[str, ...],
    connect: tuple[str, ...],
    config: Path | None,
    until_stdin_closes: bool,
    allow_open: bool,
) -> None:
    """Route messages between orchestrators and robots until Ctrl-C.

    One router per fleet is enough; agents and orchestrators reconnect when it restarts. Routers
    that are linked with --connect, in a chain or a tree, serve one fleet together. A router admits
    other machines only with the configuration of a closed fleet, or with --open.
    """
    if config is not None and (listen or connect):
        raise click.UsageError(
            "the file given with --config sets the endpoints: omit --listen and --connect"
        )
    from nufleet.orchestrator.jobs.router import run_router

    run_router(
        listen, connect, config, until_stdin_closes=until_stdin_closes, allow_open=allow_open
    )
