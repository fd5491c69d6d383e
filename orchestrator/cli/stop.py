"""`nufleet stop` and `nufleet release`: latch a stop, and end it by a separate command."""

from __future__ import annotations

import click

from nufleet.orchestrator.cli.options import connect_options


@click.command()
@click.argument("robots", nargs=-1, metavar="[ROBOT]...")
@click.option("--all", "everyone", is_flag=True, help="Stop every robot there is.")
@click.option("--reason", default="stopped by hand", show_default=True, help="Kept and shown.")
@connect_options
def stop(
    robots: tuple[str, ...], everyone: bool, reason: str, connect: str, fleet_name: str | None
) -> None:
    """Stop robots now and for good, until they are released.

    Works while a robot is busy, no matter who commands it. Without --fleet-name it stops robots of
    every fleet at the router. Ends with exit code 1, and says so loudly, when a robot does not
    confirm that it has stopped.
    """
    from nufleet.orchestrator.fleet.stopping import stop_at_router

    if everyone == bool(robots):
        raise click.UsageError("name the robots to stop, or give --all")

    def say(robot: str, why: str | None) -> None:
        if why is None:
            click.secho(f"{robot} is stopped", err=True)
        else:
            click.secho(f"{robot} DID NOT CONFIRM ITS STOP: {why}", fg="red", bold=True, err=True)

    named = None if everyone else robots
    if not stop_at_router(connect, named, reason, fleet_name=fleet_name, on_answer=say):
        click.secho("Stop these robots by hand.", fg="red", bold=True, err=True)
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("robots", nargs=-1, required=True, metavar="ROBOT...")
@connect_options
def release(robots: tuple[str, ...], connect: str, fleet_name: str | None) -> None:
    """Let stopped robots move again.

    Each named robot is asked, even if others fail. Ends with exit code 1 when one of
    them stays stopped.
    """
    from nufleet.orchestrator.fleet.connection import running_fleet
    from nufleet.shared.errors import NufleetError

    stay = False
    with running_fleet(connect, fleet_name) as connection:
        for robot in robots:
            try:
                connection.fleet.release(robot)
            except NufleetError as error:
                stay = True
                click.secho(f"{robot} was not released: {error}", fg="red", bold=True, err=True)
            else:
                click.secho(f"{robot} may move again", err=True)
    if stay:
        raise click.exceptions.Exit(1)
