"""`nufleet router`: run the Zenoh router that connects a fleet."""

from __future__ import annotations

import threading
from pathlib import Path

import click


class _Endpoint(click.types.StringParamType):
    """An endpoint. Several in an environment variable are separated by commas, since paths may
    hold spaces."""

    envvar_list_splitter = ","


@click.command()
@click.option(
    "--listen",
    type=_Endpoint(),
    multiple=True,
    envvar="NUFLEET_LISTEN",
    metavar="ENDPOINT",
    help=(
        "Where to listen, for example tcp/0.0.0.0:7447 for other machines too.  "
        "[env: NUFLEET_LISTEN; default: tcp/127.0.0.1:7447]"
    ),
)
@click.option(
    "--config",
    type=click.Path(dir_okay=False, path_type=Path),
    metavar="FILE",
    help="A Zenoh configuration (JSON5) instead, for example deploy/zenoh/router.json5.",
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
def router(listen: tuple[str, ...], config: Path | None, until_stdin_closes: bool) -> None:
    """Route messages between orchestrators and robots until Ctrl-C.

    One per fleet is enough; agents and orchestrators reconnect when it restarts.
    """
    from nufleet.shared.lifeline import when_stdin_closes
    from nufleet.shared.wire.transport import DEFAULT_ENDPOINT, open_configured_router, open_router

    if config is not None and listen:
        raise click.UsageError("the file given with --config says where to listen; leave --listen")
    ended = threading.Event()
    if until_stdin_closes:
        when_stdin_closes(ended.set)
    opening = (
        open_router(list(listen) or [DEFAULT_ENDPOINT])
        if config is None
        else open_configured_router(config)
    )
    with opening as session:
        click.echo(f"router listening on {', '.join(session.listening_on())}", err=True)
        ended.wait()
