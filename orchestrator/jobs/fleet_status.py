"""The work of `nufleet fleet status`."""

from __future__ import annotations

import json

import click

from nufleet.orchestrator.fleet.connection import running_fleet
from nufleet.orchestrator.fleet.table import fleet_table
from nufleet.orchestrator.jobs.terminal import stdout_console

STATE_TIMEOUT_S = 2.0
"""Time to wait for the first state of each robot, which is published twice a second."""


def status_and_print(connect: str, fleet_name: str | None, *, as_json: bool) -> None:
    """Print the states of all robots of a running fleet.

    Args:
        connect: Endpoint of the fleet's router.
        fleet_name: Name of the fleet; None when only one is running there.
        as_json: Whether to print the states as JSON on stdout instead of a table.

    Raises:
        NufleetError: No router answers, or the fleet is not clear.
    """
    with running_fleet(connect, fleet_name) as (fleet, name, robots):
        watches = [fleet.watch(robot) for robot in robots]
        for watch in watches:
            watch.wait_until(lambda w: w.state is not None, timeout_s=STATE_TIMEOUT_S)
        if as_json:
            states = {
                w.robot: w.state.model_dump(mode="json") if w.state else None for w in watches
            }
            click.echo(json.dumps({"schema": 1, "fleet": name, "robots": states}))
        else:
            stdout_console().print(fleet_table(name, watches))
