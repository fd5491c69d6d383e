"""`nufleet stop` and `nufleet release`: latch a stop, and end it by a separate command."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.orchestrator.cli.options import address_options, connect_options
from nufleet.shared.wire.openness import chosen_addresses


@click.command()
@click.argument("robots", nargs=-1, metavar="[ROBOT]...")
@click.option("--all", "everyone", is_flag=True, help="Stop all robots.")
@click.option(
    "--reason",
    default="stopped by hand",
    show_default=True,
    help="Reason that the robots store and show.",
)
@click.option(
    "--kill",
    is_flag=True,
    help="Cut the motors at once instead of coming to rest: what flies falls. Robots without such "
    "a switch come to rest, and are named.",
)
@address_options
def stop(
    robots: tuple[str, ...],
    everyone: bool,
    reason: str,
    kill: bool,
    connect: str | None,
    identity: Path | None,
    allow_open: bool,  # noqa: ARG001 - see below
    fleet_name: str | None,
) -> None:
    """Stop robots at once; they stay stopped until they are released.

    A robot stops even while it is busy and whichever orchestrator commands it. Without --fleet-name
    robots of every fleet at the router are stopped; with several identities and no choice among
    them, those of every fleet of which you have one. Ends with exit code 1 and a prominent message
    when a robot does not confirm that it has stopped.
    """
    if everyone == bool(robots):
        raise click.UsageError("name the robots to stop, or give --all")
    from nufleet.orchestrator.jobs.stop import stop_fleets

    # A stop of robots that any machine could command is not refused for that reason.
    fleets = chosen_addresses(connect, identity, allow_open=True)
    if not stop_fleets(fleets, fleet_name, None if everyone else robots, reason, kill=kill):
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("robots", nargs=-1, required=True, metavar="ROBOT...")
@connect_options
def release(robots: tuple[str, ...], connect: str, fleet_name: str | None) -> None:
    """Let stopped robots move again.

    Every robot named is asked, even if another one could not be released. Ends with exit code 1
    when one of them stays stopped. There is no --all on purpose: a person looks at each robot
    before it may move again.
    """
    from nufleet.orchestrator.jobs.stop import release_and_print

    if not release_and_print(connect, fleet_name, robots):
        raise click.exceptions.Exit(1)
