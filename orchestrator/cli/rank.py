"""`nufleet rank`: rank the sources by how close their dynamics are to those of the target."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import click
from click.core import ParameterSource

from nufleet.orchestrator.cli.options import (
    PositiveNumber,
    connect_options,
    json_option,
    repository_option,
    runs_option,
)


@click.command()
@click.option(
    "--fleet",
    "fleet_file",
    metavar="FILE",
    help="Start the simulated fleet of this file (or of this installed name) for this study alone.",
)
@connect_options
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0),
    default=0.0,
    metavar="SECONDS",
    help="With --connect: how long to wait for the router and the robots named.",
)
@click.option("--target", help="The robot that needs experience.  [default: the fleet file's]")
@click.option(
    "--sources",
    metavar="NAME,NAME",
    help="The robots that have some.  [default: all but the target]",
)
@click.option(
    "--band",
    type=float,
    nargs=2,
    metavar="LOW HIGH",
    help="Operating band, rad/s.  [default: the fleet file's, or what all robots accept]",
)
@click.option("--axis", help="The axis to test.  [default: the target's first]")
@click.option(
    "--iterations",
    type=click.IntRange(min=1),
    default=7,
    show_default=True,
    help="Tests per robot; with the adaptive algorithm the most rounds there may be.",
)
@click.option(
    "--seed", type=click.IntRange(min=0), default=0, show_default=True, help="Draws the first test."
)
@click.option(
    "--algorithm",
    type=click.Choice(["adaptive", "paper"]),
    default="adaptive",
    show_default=True,
    help=(
        "Tests of many tones that end when the choice is sure, or the paper's Algorithm 1: one "
        "tone per test, as many tests as --iterations says."
    ),
)
@click.option(
    "--reuse",
    "reuse_days",
    type=click.FloatRange(min=0),
    is_flag=False,
    flag_value=30.0,
    metavar="[DAYS]",
    help=(
        "Sources with stored responses that are no older than this "
        "(30 days without a number) do not fly, and need not be there; the result names them."
    ),
)
@click.option(
    "--trajectory",
    metavar="FILE|NAME",
    help="Rank for this drawing (CSV or SVG, or an installed one such as `pear`).",
)
@click.option(
    "--speed",
    "speed_m_s",
    type=PositiveNumber(),
    metavar="M/S",
    help="With --trajectory: the largest speed on it.  [default: what the target's axis allows]",
)
@click.option(
    "--realtime",
    type=PositiveNumber(),
    metavar="FACTOR",
    help="With --fleet: play at this multiple of real time.  [default: as fast as possible]",
)
@click.option(
    "--live",
    is_flag=True,
    help="Serve the recording while the study runs; `nufleet view --live` shows it.",
)
@click.option(
    "--resume",
    metavar="RUN",
    help="Go on with this interrupted run, or the `latest`; target, band and all else are its.",
)
@runs_option
@repository_option
@json_option
def rank(
    fleet_file: str | None,
    connect: str,
    fleet_name: str | None,
    wait_s: float,
    target: str | None,
    sources: str | None,
    band: tuple[float, float] | None,
    axis: str | None,
    iterations: int,
    seed: int,
    algorithm: Literal["paper", "adaptive"],
    reuse_days: float | None,
    trajectory: str | None,
    speed_m_s: float | None,
    realtime: float | None,
    live: bool,
    resume: str | None,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Rank source robots by their worst-case chordal distance to a target.

    All robots play many tones at once, and only those that may still win play again, until the
    choice is right with probability 0.95; with --algorithm paper all play one tone at a time,
    chosen by Bayesian optimisation (Algorithm 1 of Sorocky, Zhou, Schoellig, ICRA 2020). The
    closest source's experience is expected to help the target most, and for each source the result
    says whether it will help at all. With --trajectory the best source is the one whose inverse
    leaves the smallest error on that. Ctrl-C brings all robots to rest.

    \b
    nufleet rank --fleet paper_linear
    nufleet rank --fleet paper_linear --trajectory pear --speed 0.6
    nufleet rank --connect tcp/192.168.1.10:7447 --target drone-7 --band 0.1 5.4
    """
    if resume is not None:
        _go_on(resume)
        return
    from nufleet.orchestrator.jobs.rank import RankCommand, rank_and_print
    from nufleet.shared.robots.fleet_file import find_fleet_file

    rank_and_print(
        RankCommand(
            fleet_file=None if fleet_file is None else find_fleet_file(fleet_file),
            connect=connect,
            fleet_name=fleet_name,
            wait_s=wait_s,
            target=target,
            sources=None if sources is None else tuple(sources.split(",")),
            band_rad_s=band,
            axis=axis,
            iterations=iterations,
            seed=seed,
            algorithm=algorithm,
            reuse_days=reuse_days,
            trajectory=trajectory,
            speed_m_s=speed_m_s,
            realtime=realtime,
            live=live,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )


_OF_A_RESUMPTION = {
    *("resume", "connect", "wait_s", "live", "runs_root", "repository", "as_json"),
}


def _go_on(run: str) -> None:
    from nufleet.orchestrator.jobs.resume import ResumeCommand, resume_and_print

    context = click.get_current_context()
    given = [
        option
        for option in context.command.params
        if context.get_parameter_source(option.name or "") is ParameterSource.COMMANDLINE
    ]
    for option in given:
        if option.name not in _OF_A_RESUMPTION:
            raise click.UsageError(f"{option.opts[0]} is taken from the run; omit it to resume")
    connect = next((o for o in given if o.name == "connect"), None)
    options = context.params
    resume_and_print(
        ResumeCommand(
            run=run,
            connect=None if connect is None else options["connect"],
            wait_s=options["wait_s"],
            live=options["live"],
            runs_root=options["runs_root"],
            repository=options["repository"],
            as_json=options["as_json"],
        )
    )
