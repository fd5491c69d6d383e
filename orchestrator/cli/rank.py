"""`nufleet rank`: rank the sources by how close their dynamics are to those of the target."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    band_option,
    connect_options,
    fleet_option,
    live_option,
    moving_options,
    realtime_option,
    recording_option,
    refuse_in_vain,
    rehearsal_option,
    seed_option,
    storage_options,
    typed_options,
    wait_option,
)
from nufleet.orchestrator.cli.types import (
    AlgorithmName,
    DrawingName,
    Names,
    Number,
    PositiveNumber,
    RobotName,
)


@click.command()
@fleet_option
@connect_options
@wait_option("With --connect: how long to wait for the router and the robots named.")
@click.option(
    "--target",
    type=RobotName(),
    metavar="NAME",
    help="Robot that needs experience.  [default: the target named in the fleet file]",
)
@click.option(
    "--sources",
    type=Names(),
    metavar="NAME,NAME",
    help="Robots that have experience.  [default: all but the target]",
)
@band_option("Operating band")
@click.option("--axis", metavar="NAME", help="Only axis to test.")
@click.option(
    "--axes",
    type=Names(),
    metavar="NAME,NAME",
    help=(
        "Axes to test together; sources are compared by their worst axis.  [default: `all` that "
        "the robots have in common; with --algorithm paper, the target's first]"
    ),
)
@click.option(
    "--iterations",
    type=click.IntRange(min=1),
    default=7,
    show_default=True,
    help="Tests per robot; with the adaptive algorithm, the largest number of rounds.",
)
@click.option(
    "--precision",
    type=PositiveNumber(),
    metavar="WIDTH",
    help="Continue until the 95 % interval of the selected source's distance is no wider than "
    "this.",
)
@click.option(
    "--amplitude",
    type=PositiveNumber(),
    metavar="A",
    help=(
        "Amplitude of the task in m (rad for angles), at which distances are meant; robots whose "
        "limits are tighter play less.  [default: that of --trajectory, or what each robot's "
        "limits allow]"
    ),
)
@seed_option("Seed of the random choices, such as the first test.")
@click.option(
    "--algorithm",
    type=AlgorithmName(),
    metavar="NAME",
    default="adaptive",
    show_default=True,
    help=(
        "`adaptive` plays many tones per test and stops when the choice is sure; `paper` is the "
        "paper's Algorithm 1, with one tone per test and --iterations tests. Packages may install "
        "others."
    ),
)
@click.option(
    "--reuse",
    "reuse_days",
    type=Number(0.0, unit="days"),
    is_flag=False,
    flag_value=30.0,
    metavar="[DAYS]",
    help=(
        "Do not test sources with stored responses at most this old (30 days without a number). "
        "They need not be present; the result names them."
    ),
)
@click.option(
    "--trajectory",
    type=DrawingName(),
    metavar="FILE|NAME",
    help="Rank for this drawing (CSV or SVG, or an installed one such as `pear`).",
)
@click.option(
    "--speed",
    "speed_m_s",
    type=PositiveNumber(),
    metavar="M/S",
    help="With --trajectory: largest speed on it.  [default: what the target's axis allows]",
)
@realtime_option
@moving_options
@rehearsal_option
@live_option
@recording_option
@click.option(
    "--resume",
    metavar="RUN",
    help="Resume this interrupted run (or `latest`) with its own target, band and other settings.",
)
@storage_options
def rank(resume: str | None, **options: Any) -> None:
    """Rank source robots by their worst-case chordal distance to a target.

    All robots play many tones at once. Sources that can no longer win are dropped, and the others
    are tested again until the choice is right with probability 0.95. With --algorithm paper, all
    robots play one tone at a time, chosen by Bayesian optimisation (Algorithm 1 of Sorocky, Zhou,
    Schoellig, ICRA 2020). The closest source's experience is expected to help the target most, and
    the result says for each source whether it will help at all. With --trajectory, the best source
    is the one whose inverse leaves the smallest error on that drawing. Ctrl-C brings all robots to
    rest.

    \b
    nufleet rank --fleet paper_linear
    nufleet rank --fleet paper_linear --trajectory pear --speed 0.6
    nufleet rank --connect tcp/192.168.1.10:7447 --target drone-7 --band 0.1 5.4
    """
    if resume is not None:
        _resume(resume, options)
        return
    if options["fleet_file"] is None:
        refuse_in_vain("without --fleet", "realtime")
    from nufleet.orchestrator.jobs.rank import RankCommand, rank_and_print

    rank_and_print(RankCommand(**options))


def _resume(run: str, options: dict[str, Any]) -> None:
    from dataclasses import fields

    from nufleet.orchestrator.jobs.resume import ResumeCommand, resume_and_print

    typed = typed_options()
    resumable = {field.name for field in fields(ResumeCommand)}
    for name, option in typed.items():
        if name not in {"resume", "identity", "allow_open", *resumable}:
            raise click.UsageError(f"{option} is already set by the run; omit it with --resume")
    if not typed.keys() & {"connect", "identity"}:
        options["connect"] = None  # the default would replace the router that the run used
    taken = {name: value for name, value in options.items() if name in resumable}
    resume_and_print(ResumeCommand(run=run, **taken))
