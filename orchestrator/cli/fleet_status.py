"""`nufleet fleet status`: list the robots of a fleet and their states."""

from __future__ import annotations

import click

from nufleet.orchestrator.cli.options import connect_options, json_option


@click.command()
@connect_options
@json_option
def status(connect: str, fleet_name: str | None, as_json: bool) -> None:
    """Show the robots of a running fleet and what each of them does."""
    import json

    from nufleet.orchestrator.fleet.connection import running_fleet
    from nufleet.orchestrator.fleet.table import fleet_table
    from nufleet.orchestrator.runs.console import stderr_console

    with running_fleet(connect, fleet_name) as connection:
        fleet = connection.fleet
        robots = connection.robots
        for robot in robots:
            fleet.watch(robot).wait_until(lambda w: w.state is not None, timeout_s=2.0)
        watches = [fleet.watch(robot) for robot in robots]
        if as_json:
            states = {
                w.robot: w.state.model_dump(mode="json") if w.state else None for w in watches
            }
            click.echo(json.dumps({"schema": 1, "fleet": connection.name, "robots": states}))
        else:
            stderr_console().print(fleet_table(connection.name, watches))
