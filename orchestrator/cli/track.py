"""`nufleet track`: fly a drawing."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    connect_options,
    live_option,
    moving_options,
    refuse_in_vain,
    rehearsal_option,
    storage_options,
    unguarded_option,
)
from nufleet.orchestrator.cli.types import DrawingName, PositiveNumber


@click.command()
@connect_options
@click.option("--target", required=True, metavar="NAME", help="Robot that flies.")
@click.option(
    "--trajectory",
    "drawings",
    type=DrawingName(),
    required=True,
    multiple=True,
    metavar="FILE|NAME",
    help=(
        "Drawing: a CSV file of x and y, an SVG file, or one of clover, pear, ribbon, scrawl and "
        "shell. May be repeated."
    ),
)
@click.option(
    "--speed",
    type=PositiveNumber(),
    default=0.6,
    show_default=True,
    metavar="M_S",
    help="Largest speed on the path, and on the way to it, in the unit of the robot's axes per "
    "second.",
)
@click.option(
    "--scale",
    type=PositiveNumber(),
    default=1.0,
    show_default=True,
    help="Factor on the size of the drawing.",
)
@click.option(
    "--inverse",
    type=click.Choice(["auto", "prior", "by-axis", "mixture", "own", "zero-prior", "baseline"]),
    default="auto",
    show_default=True,
    help=(
        "Inverse model in front of the robot's own controller: the prior that was transferred to "
        "it, on each axis the one from its closest source (`by-axis`), a mixture of all of them, "
        "its model of itself from all that it has flown (`own`), a model learned online from "
        "nothing, or none (`baseline`). `auto` takes the prior if the latest ranking chose its "
        "source or it is a preview, by axis if `transfer --source best` chose them so, otherwise a "
        "mixture of all priors and of no experience, and without a prior the baseline."
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
    "--no-learning",
    "learn",
    flag_value=False,
    default=True,
    help="Use the prior unchanged, without learning in flight.",
)
@click.option(
    "--rich-flight",
    "rich_flight_s",
    type=PositiveNumber(),
    metavar="SECONDS",
    help="Fly a persistently exciting reference for this long first, to learn more of the robot.",
)
@unguarded_option
@moving_options
@rehearsal_option
@live_option
@storage_options
def track(**options: Any) -> None:
    """Have a robot track a hand drawing, with or without a transferred prior.

    A drawing that leaves the workspace or exceeds the robot's limits is refused before anything
    moves. Ctrl-C brings the robot to rest.

    \b
    nufleet track --target drone-7 --trajectory clover --speed 0.6
    """
    inverse = options["inverse"]
    if inverse != "zero-prior":
        refuse_in_vain("without --inverse zero-prior", "horizon_s")
    if inverse in ("own", "zero-prior", "baseline"):
        refuse_in_vain(f"with --inverse {inverse}", "learn")
    if inverse == "baseline":
        refuse_in_vain("with --inverse baseline", "guarded")
    from nufleet.orchestrator.jobs.track import TrackCommand, track_and_print

    track_and_print(TrackCommand(**options))
