"""`nufleet track`: fly a drawing."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from nufleet.orchestrator.cli.options import (
    PositiveNumber,
    connect_options,
    json_option,
    live_option,
    repository_option,
    runs_option,
)


@click.command()
@connect_options
@click.option("--target", required=True, metavar="NAME", help="Who flies.")
@click.option(
    "--trajectory",
    "drawings",
    required=True,
    multiple=True,
    metavar="FILE|NAME",
    help=(
        "A drawing: a CSV file of x and y, an SVG file, or one of clover, pear, ribbon, scrawl "
        "and shell. May be given several times."
    ),
)
@click.option(
    "--speed",
    type=PositiveNumber(),
    default=0.6,
    show_default=True,
    metavar="M_S",
    help="Along the path, in unit/s of the robot's axes.",
)
@click.option(
    "--scale",
    type=PositiveNumber(),
    default=1.0,
    show_default=True,
    help="Makes the drawing larger or smaller.",
)
@click.option(
    "--inverse",
    type=click.Choice(["auto", "prior", "own", "zero-prior", "baseline"]),
    default="auto",
    show_default=True,
    help=(
        "What stands in front of the robot's own controller: the prior that was transferred to it, "
        "its own model of itself from what it has flown, an online process that begins with "
        "nothing, or nothing. `auto` takes the prior if there is one, else the baseline."
    ),
)
@click.option(
    "--horizon",
    "horizon_s",
    type=PositiveNumber(),
    default=0.4,
    show_default=True,
    metavar="SECONDS",
    help="With --inverse zero-prior: how far ahead its feedback aims.",
)
@click.option(
    "--no-learning", is_flag=True, help="Use the prior as it is, without the online process."
)
@click.option(
    "--no-guard",
    is_flag=True,
    help="Never fall back to the baseline; only a robot whose fleet file allows it flies so.",
)
@click.option(
    "--rich-flight",
    "rich_flight_s",
    type=PositiveNumber(),
    metavar="SECONDS",
    help="First fly a rich flight that long, from which the robot learns more of itself.",
)
@live_option
@runs_option
@repository_option
@json_option
def track(
    connect: str,
    fleet_name: str | None,
    target: str,
    drawings: tuple[str, ...],
    speed: float,
    scale: float,
    inverse: Literal["auto", "prior", "own", "zero-prior", "baseline"],
    horizon_s: float,
    no_learning: bool,
    no_guard: bool,
    rich_flight_s: float | None,
    live: bool,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Have a robot track a hand drawing, with or without a transferred prior.

    A drawing that leaves the workspace or is faster than the robot's limits is refused before
    anything moves. Ctrl-C brings the robot to rest.

    \b
    nufleet track --target drone-7 --trajectory clover --speed 0.6
    """
    from nufleet.orchestrator.jobs.track import TrackCommand, track_and_print

    track_and_print(
        TrackCommand(
            connect=connect,
            fleet_name=fleet_name,
            target=target,
            drawings=drawings,
            speed=speed,
            scale=scale,
            inverse=inverse,
            horizon_s=horizon_s,
            learn=not no_learning,
            guarded=not no_guard,
            rich_flight_s=rich_flight_s,
            live=live,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )
