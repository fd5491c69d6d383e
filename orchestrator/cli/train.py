"""`nufleet train`: give a robot an experience of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from nufleet.orchestrator.cli.options import (
    PositiveNumber,
    connect_options,
    json_option,
    repository_option,
    runs_option,
)


@click.command()
@connect_options
@click.option(
    "--robot",
    "robots",
    multiple=True,
    metavar="NAME",
    help="Who learns; may be given several times.  [default: all robots that are there]",
)
@click.option(
    "--architecture",
    type=click.Choice(["state", "preview", "both"]),
    default="state",
    show_default=True,
    help=(
        "What the inverse model is fed with: the robot's own state, as in the paper, or the path "
        "ahead, a filter whose error the frequency tests predict."
    ),
)
@click.option(
    "--duration",
    "duration_s",
    type=PositiveNumber(60, 600),
    default=120.0,
    show_default=True,
    metavar="SECONDS",
    help="Of the flight that the experience is learned from.",
)
@click.option(
    "--seed",
    type=click.IntRange(min=0),
    default=0,
    show_default=True,
    help="Draws the flight and the network's first weights.",
)
@runs_option
@repository_option
@json_option
def train(
    connect: str,
    fleet_name: str | None,
    robots: tuple[str, ...],
    architecture: Literal["state", "preview", "both"],
    duration_s: float,
    seed: int,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Have robots learn an inverse model of themselves, which they then offer to others.

    Each robot flies for two minutes under its limits, some small steps, and a practice path with
    candidate horizons; a network (4 x 128 ReLU, 2100 points) is trained here and installed on the
    robot, which keeps it across restarts. Ctrl-C brings all robots to rest.

    \b
    nufleet train --robot drone-3
    """
    from nufleet.orchestrator.jobs.train import TrainCommand, train_and_print

    train_and_print(
        TrainCommand(
            connect=connect,
            fleet_name=fleet_name,
            robots=robots,
            architectures=("state", "preview") if architecture == "both" else (architecture,),
            duration_s=duration_s,
            seed=seed,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )
