"""`nufleet fleet up`: run a router and the simulated robots of a fleet file in the foreground."""

from __future__ import annotations

import click


@click.command()
@click.argument("fleet_file", metavar="FLEET")
@click.option(
    "--listen",
    default="tcp/127.0.0.1:7447",
    show_default=True,
    metavar="ENDPOINT",
    help="Where the router listens, for example tcp/0.0.0.0:7447 for other machines too.",
)
@click.option("--processes", is_flag=True, help="Give every robot a process of its own.")
@click.option(
    "--realtime",
    type=click.FloatRange(min=0, min_open=True),
    metavar="FACTOR",
    help="Play at this multiple of real time.  [default: as fast as possible]",
)
def up(fleet_file: str, listen: str, processes: bool, realtime: float | None) -> None:
    """Start a router and all robots of FLEET; Ctrl-C ends them, at rest.

    FLEET is a fleet file, or the name of an installed one.

    \b
    nufleet fleet up paper_linear --realtime 1
    """
    from nufleet.orchestrator.jobs.fleet_up import fleet_up
    from nufleet.shared.robots.fleet_file import find_fleet_file

    fleet_up(find_fleet_file(fleet_file), listen=listen, processes=processes, realtime=realtime)
