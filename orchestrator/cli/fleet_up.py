"""`nufleet fleet up`: run a router and the simulated robots of a fleet file in the foreground."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import open_option
from nufleet.orchestrator.cli.types import FleetPath, PositiveNumber


@click.command()
@click.argument("fleet_file", type=FleetPath(), metavar="FLEET")
@click.option(
    "--listen",
    default="tcp/127.0.0.1:7447",
    envvar="NUFLEET_LISTEN",
    metavar="ENDPOINT",
    help="Endpoint of the router, such as tcp/127.0.0.1:7448.  "
    "[env: NUFLEET_LISTEN; default: tcp/127.0.0.1:7447]",
)
@open_option
@click.option("--processes", is_flag=True, help="Give every robot a process of its own.")
@click.option(
    "--realtime",
    type=PositiveNumber(),
    metavar="FACTOR",
    help="Run at this multiple of real time.  [default: as fast as possible]",
)
def up(**options: Any) -> None:
    """Start a router and all robots of FLEET; Ctrl-C brings the robots to rest and ends both.

    FLEET is a fleet file, or the name of an installed one.

    \b
    nufleet fleet up paper_linear --realtime 1
    """
    from nufleet.orchestrator.jobs.fleet_up import fleet_up

    fleet_up(**options)
