"""`nufleet match`: how well does a simulator match a robot?"""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    band_option,
    connect_options,
    fleet_option,
    moving_options,
    realtime_option,
    refuse_in_vain,
    seed_option,
    storage_options,
    wait_option,
)
from nufleet.orchestrator.cli.types import Names, PositiveNumber, RobotName


@click.command()
@fleet_option
@connect_options
@wait_option("With --connect: how long to wait for the router and the robots named.")
@click.option(
    "--robot",
    "target",
    type=RobotName(),
    metavar="NAME",
    help="Robot.  [default: the target of the file]",
)
@click.option(
    "--simulators",
    "sources",
    type=Names(),
    metavar="NAME,NAME",
    help="Simulated robots to compare with it, or one with several settings.  [default: all but "
    "the robot]",
)
@band_option("Band of the tests")
@click.option("--axis", help="Axis to test.  [default: the robot's first]")
@click.option(
    "--rounds",
    "iterations",
    type=click.IntRange(min=1),
    default=3,
    show_default=True,
    help="Largest number of rounds of tests.",
)
@click.option(
    "--fit",
    type=Names(),
    metavar="SETTING,SETTING",
    help="Then vary these settings of the simulator until it agrees with the robot.",
)
@click.option(
    "--max",
    "psi_max",
    type=PositiveNumber(),
    metavar="PSI",
    help="End with exit code 1 if even the best simulator is further from the robot than this, "
    "after the fit if there is one.",
)
@realtime_option
@moving_options
@seed_option("Seed of the random choices.")
@storage_options
def match(**options: Any) -> None:
    """Print how well simulators match a robot, and in which way they differ from it.

    Robot and simulators play the same tones. The result is the chordal distance ψ between their
    responses, from 0 (equal) to 1, with the frequency at which it is largest, and the differences
    in delay, stiffness and gain. With --fit, the simulator plays the tests again with other
    settings, which moves no robot, and the result is also the values that agree best.

    \b
    nufleet match --fleet lab.toml --robot cf-1 --simulators sim --max 0.05
    nufleet match --fleet lab.toml --robot cf-1 --simulators sim --fit mass_kg,delay_s
    """
    from nufleet.orchestrator.jobs.match import MatchCommand, match_and_print

    if options["fleet_file"] is None:
        refuse_in_vain("without --fleet", "realtime", "fit")
    if not match_and_print(MatchCommand(**options)):
        raise click.exceptions.Exit(1)
