"""`nufleet stop` and `nufleet release`: a latched stop, and the separate act that ends it."""

from __future__ import annotations

import click

from orchestrator.cli.options import connect_options


@click.command()
@click.argument("robots", nargs=-1, metavar="[ROBOT]...")
@click.option("--all", "everyone", is_flag=True, help="Stop every robot of the fleet.")
@click.option("--reason", default="stopped by hand", show_default=True, help="Kept and shown.")
@connect_options
def stop(
    robots: tuple[str, ...], everyone: bool, reason: str, connect: str, fleet_name: str | None
) -> None:
    """Stop robots now and for good, until they are released.

    Works while a robot is busy and whoever commands it. Ends with exit code 1, and says so loudly,
    when a robot does not confirm that it has stopped.
    """
    from orchestrator.connection import running_fleet
    from orchestrator.stopping import stop_robots

    if everyone == bool(robots):
        raise click.UsageError("name the robots to stop, or give --all")
    with running_fleet(connect, fleet_name) as connection:
        names = connection.robots if everyone else robots
        if everyone:
            connection.fleet.stop_everyone(reason)
        unconfirmed = stop_robots(connection.fleet, names, reason)
    for robot in names:
        if robot not in unconfirmed:
            click.secho(f"{robot} is stopped", err=True)
    for robot, why in unconfirmed.items():
        click.secho(f"{robot} DID NOT CONFIRM ITS STOP: {why}", fg="red", bold=True, err=True)
    if unconfirmed:
        click.secho("Stop these robots by hand.", fg="red", bold=True, err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("robots", nargs=-1, required=True, metavar="ROBOT...")
@connect_options
def release(robots: tuple[str, ...], connect: str, fleet_name: str | None) -> None:
    """Let stopped robots move again."""
    from orchestrator.connection import running_fleet

    with running_fleet(connect, fleet_name) as connection:
        for robot in robots:
            connection.fleet.release(robot)
            click.secho(f"{robot} may move again", err=True)
