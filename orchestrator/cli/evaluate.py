"""`nufleet evaluate`: test in flight whether the prediction holds."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    connect_options,
    fleet_option,
    live_option,
    moving_options,
    seed_option,
    storage_options,
    unguarded_option,
)
from nufleet.orchestrator.cli.types import (
    Durations,
    Names,
    PositiveNumber,
    PositiveNumbers,
    RobotName,
)


@click.command()
@fleet_option
@connect_options
@click.option(
    "--target",
    type=RobotName(),
    metavar="NAME",
    help="Robot that flies.  [default: the target named in the fleet file]",
)
@click.option(
    "--sources",
    type=Names(),
    metavar="NAME,NAME",
    help="Robots whose experiences it flies with.  [default: all but the target]",
)
@click.option(
    "--architecture",
    type=click.Choice(["state", "preview"]),
    default="state",
    show_default=True,
    help=(
        "Input of the inverse models: the robot's own state, as in the paper, or the path ahead, "
        "for which the frequency tests predict the error."
    ),
)
@click.option(
    "--drawings",
    type=Names(),
    metavar="NAME,FILE,...",
    help="Drawings to fly, by name or file.  [default: the five that are installed]",
)
@click.option(
    "--speeds",
    type=PositiveNumbers(),
    metavar="M_S,M_S",
    help="Largest speeds on the drawings.  [default: 0.3,0.6,0.9 as in the paper]",
)
@click.option(
    "--scale",
    type=PositiveNumber(),
    default=1.0,
    show_default=True,
    help="Factor on the size of the drawings.",
)
@click.option(
    "--own-flight",
    "own_flight_s",
    type=Durations(),
    metavar="S,S,...",
    help=(
        "Seconds of the target's own flying beyond its tests, after each of which it flies with "
        "its model of itself.  [default: 0,5,15,30,60,120; with --quick 0,15,30; with --all-pairs "
        "0]"
    ),
)
@click.option(
    "--studies",
    type=click.IntRange(min=1),
    help=(
        "How many times Algorithm 1 ranks the sources, each time with another seed.  [default: 10; "
        "with --quick 2; with --all-pairs 1]"
    ),
)
@click.option(
    "--iterations",
    type=click.IntRange(min=2),
    default=7,
    show_default=True,
    help="Iterations of each of these studies.",
)
@click.option(
    "--quick",
    is_flag=True,
    help="Fly two drawings at one speed, with two studies and a shorter flight to learn from.",
)
@click.option(
    "--all-pairs",
    is_flag=True,
    help="Take every robot as target, with all others as sources: how well does ψ predict overall?",
)
@unguarded_option
@seed_option()
@moving_options
@live_option
@storage_options
def evaluate(**options: Any) -> None:
    """Fly a target along drawings with every source's experience, and compare with the prediction.

    Sources without an experience learn one first. Frequency tests rank the sources; then the target
    flies every drawing with its baseline alone, with a model learned online from nothing, with each
    source's experience as its prior mean (the paper's Section VI, Table I, Figs. 4 and 7), with
    their mixture, and with its model of itself: after the tests alone, and again after more flying
    of its own. Plots, tables and all samples go into the run's folder, where flights.jsonl holds
    the result of every flight as soon as it ends. `nufleet runs resume` continues an evaluation
    that was interrupted.

    \b
    nufleet evaluate --fleet paper_quadrotors --quick
    """
    from nufleet.orchestrator.jobs.evaluate import EvaluateCommand, evaluate_and_print

    evaluate_and_print(EvaluateCommand(**options))
