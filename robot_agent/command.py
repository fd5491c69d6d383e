"""`nufleet agent`: serve one or more robots of a fleet file."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("fleet_file", type=click.Path(dir_okay=False, path_type=Path))
@click.option(
    "--robot",
    "robots",
    multiple=True,
    metavar="NAME",
    help="A robot of the file to serve; may be given several times.  [default: all of them]",
)
@click.option(
    "--connect",
    default="tcp/127.0.0.1:7447",
    show_default=True,
    envvar="NUFLEET_ROUTER",
    metavar="ENDPOINT",
    help="Where the router listens.  [env: NUFLEET_ROUTER]",
)
@click.option(
    "--realtime",
    type=click.FloatRange(min=0, min_open=True),
    metavar="FACTOR",
    help="Play simulated robots at this multiple of real time.  [default: as fast as they can]",
)
@click.option("--until-stdin-closes", is_flag=True, hidden=True)
def agent(
    fleet_file: Path,
    robots: tuple[str, ...],
    connect: str,
    realtime: float | None,
    until_stdin_closes: bool,
) -> None:
    """Serve robots of FLEET_FILE to the fleet, each at rest when nothing is asked of it.

    Runs until Ctrl-C. It waits for the router when there is none yet, and survives its restarts.
    The robot is brought to rest when this agent ends, when the orchestrator that commands it
    disappears, and when anyone stops it.
    """
    from robot_agent.serve import serve

    serve(
        fleet_file,
        robots,
        connect=connect,
        realtime=realtime,
        until_stdin_closes=until_stdin_closes,
    )
