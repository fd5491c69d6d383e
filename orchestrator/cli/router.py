"""`nufleet router`: the Zenoh router that a fleet meets at."""

from __future__ import annotations

import threading

import click


@click.command()
@click.option(
    "--listen",
    multiple=True,
    default=("tcp/127.0.0.1:7447",),
    show_default=True,
    metavar="ENDPOINT",
    help="Where to listen, for example tcp/0.0.0.0:7447 for other machines too.",
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
def router(listen: tuple[str, ...], until_stdin_closes: bool) -> None:
    """Route messages between orchestrators and robots until Ctrl-C.

    One per fleet is enough; agents and orchestrators reconnect when it restarts.
    """
    from shared.lifeline import when_stdin_closes
    from shared.transport import open_router

    ended = threading.Event()
    if until_stdin_closes:
        when_stdin_closes(ended.set)
    with open_router(list(listen)) as session:
        click.echo(f"router listening on {', '.join(session.listening_on())}", err=True)
        ended.wait()
