"""`nufleet train`: give a robot an experience of its own."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    connect_options,
    moving_options,
    seed_option,
    storage_options,
)
from nufleet.orchestrator.cli.types import PositiveNumber


def _architectures(_context: click.Context, _option: click.Parameter, chosen: str) -> Any:
    return ("state", "preview") if chosen == "both" else (chosen,)


@click.command()
@connect_options
@click.option(
    "--robot",
    "robots",
    multiple=True,
    metavar="NAME",
    help="Robot that learns; may be repeated.  [default: all robots of the fleet]",
)
@click.option(
    "--architecture",
    "architectures",
    type=click.Choice(["state", "preview", "both"]),
    default="state",
    show_default=True,
    callback=_architectures,
    help=(
        "Input of the inverse model: `state` is the robot's own state, as in the paper; `preview` "
        "is the path ahead, which makes the model a filter whose error the frequency tests predict."
    ),
)
@click.option(
    "--duration",
    "duration_s",
    type=PositiveNumber(60, 600),
    default=120.0,
    show_default=True,
    metavar="SECONDS",
    help="Duration of the flight that the robot learns from.",
)
@seed_option("Seed of the flight and of the network's first weights.")
@moving_options
@storage_options
def train(**options: Any) -> None:
    """Have robots learn an inverse model of themselves, which they then offer to others.

    Each robot flies for two minutes within its limits, then some small steps, then a practice path
    with each candidate horizon. A network (4 x 128 ReLU, 2100 points) is trained on this machine
    and installed on the robot, which keeps it across restarts. Ctrl-C brings all robots to rest.

    \b
    nufleet train --robot drone-3
    """
    from nufleet.orchestrator.jobs.train import TrainCommand, train_and_print

    train_and_print(TrainCommand(**options))
