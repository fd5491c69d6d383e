"""`nufleet evaluate`: test in flight whether the prediction holds."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click

from nufleet.orchestrator.cli.options import (
    PositiveNumber,
    connect_options,
    fleet_option,
    json_option,
    live_option,
    repository_option,
    runs_option,
)


@click.command()
@fleet_option
@connect_options
@click.option("--target", help="The robot that flies.  [default: the fleet file's]")
@click.option(
    "--sources",
    metavar="NAME,NAME",
    help="Whose experiences it flies with.  [default: all but the target]",
)
@click.option(
    "--architecture",
    type=click.Choice(["state", "preview"]),
    default="state",
    show_default=True,
    help=(
        "Inverse models fed with the robot's own state, as in the paper, or with the path ahead, "
        "whose error the frequency tests predict."
    ),
)
@click.option(
    "--drawings",
    metavar="NAME,FILE,...",
    help="What is flown: drawings by name or file.  [default: the five that are installed]",
)
@click.option(
    "--speeds",
    metavar="M_S,M_S",
    help="Along the drawings.  [default: 0.3,0.6,0.9 as in the paper]",
)
@click.option(
    "--scale",
    type=PositiveNumber(),
    default=1.0,
    show_default=True,
    help="Makes the drawings larger or smaller.",
)
@click.option(
    "--studies",
    type=click.IntRange(min=1),
    help=(
        "How many times Algorithm 1 ranks the sources, each with its own seed.  [default: 10; with "
        "--quick 2; with --all-pairs 1]"
    ),
)
@click.option(
    "--iterations",
    type=click.IntRange(min=2),
    default=7,
    show_default=True,
    help="Of each of these studies.",
)
@click.option(
    "--quick",
    is_flag=True,
    help="Two drawings at one speed, two studies and a shorter flight to learn from.",
)
@click.option(
    "--all-pairs",
    is_flag=True,
    help="Every robot as target, all others as its sources: how well ψ predicts in general.",
)
@click.option(
    "--no-guard",
    is_flag=True,
    help="Never fall back to the baseline; only a robot whose fleet file allows it flies so.",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@live_option
@runs_option
@repository_option
@json_option
def evaluate(
    fleet_file: str | None,
    connect: str,
    fleet_name: str | None,
    target: str | None,
    sources: str | None,
    architecture: Literal["state", "preview"],
    drawings: str | None,
    speeds: str | None,
    scale: float,
    studies: int | None,
    iterations: int,
    quick: bool,
    all_pairs: bool,
    no_guard: bool,
    seed: int,
    live: bool,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Fly a target along drawings with every source's experience, and compare with the prediction.

    Experiences that sources do not have yet are trained first. The sources are ranked by frequency
    tests; then the target flies every drawing with its baseline alone, with an online process that
    begins with nothing, and with each source's experience as its prior mean (the paper's Section
    VI, Table I, Figs. 4 and 7). Plots, tables and every sample go into the run's folder.

    \b
    nufleet evaluate --fleet paper_quadrotors --quick
    """
    from nufleet.orchestrator.jobs.evaluate import EvaluateCommand, evaluate_and_print
    from nufleet.shared.robots.fleet_file import find_fleet_file

    evaluate_and_print(
        EvaluateCommand(
            fleet_file=None if fleet_file is None else find_fleet_file(fleet_file),
            connect=connect,
            fleet_name=fleet_name,
            target=target,
            sources=None if sources is None else tuple(sources.split(",")),
            architecture=architecture,
            drawings=None if drawings is None else tuple(drawings.split(",")),
            speeds=None if speeds is None else _numbers(speeds),
            scale=scale,
            studies=studies,
            iterations=iterations,
            quick=quick,
            all_pairs=all_pairs,
            guarded=not no_guard,
            seed=seed,
            live=live,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )


def _numbers(text: str) -> tuple[float, ...]:
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError as error:
        raise click.BadParameter(f"{text!r}: expected numbers such as 0.3,0.6,0.9") from error
    if not all(0 < number < float("inf") for number in numbers):
        raise click.BadParameter(f"{text!r}: speeds must be above 0")
    return numbers
