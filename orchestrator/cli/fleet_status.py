"""`nufleet fleet status`: list the robots of a fleet and their states."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import connect_options, json_option


@click.command()
@connect_options
@json_option
def status(**options: Any) -> None:
    """Show the robots of a running fleet and the state of each."""
    from nufleet.orchestrator.jobs.fleet_status import status_and_print

    status_and_print(**options)
