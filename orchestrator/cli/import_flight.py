"""`nufleet import`: make a flight that exists into a response of its robot."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    connect_options,
    fleet_option,
    refuse_in_vain,
    storage_options,
    typed_options,
)
from nufleet.orchestrator.cli.types import Number, PositiveNumber


@click.command("import")
@click.argument("log", metavar="FILE", type=click.Path(path_type=Path))
@click.option("--robot", metavar="NAME", help="The robot that flew.")
@click.option("--axis", metavar="NAME", help="Of which axis.  [default: the robot's first]")
@click.option(
    "--reference",
    metavar="TOPIC.FIELD",
    help="The position that the robot was sent.  [default: the format's usual setpoint]",
)
@click.option(
    "--output",
    metavar="TOPIC.FIELD",
    help="The position that was measured.  [default: the format's usual position]",
)
@click.option(
    "--time",
    metavar="COLUMN[:UNIT]",
    help="Of a table: the column of times, in s, ms, us or ns.  [default: t, time, time_ms, ...]",
)
@click.option(
    "--from",
    "begin_s",
    type=Number(0.0, unit="s"),
    default=0.0,
    metavar="S",
    help="Leave out what lies before, in s from the beginning of the log.",
)
@click.option(
    "--to",
    "end_s",
    type=PositiveNumber(unit="s"),
    metavar="S",
    help="Leave out what lies after, in s from the beginning of the log.",
)
@click.option("--list", "lists", is_flag=True, help="Only list the signals in FILE.")
@fleet_option
@connect_options
@storage_options
def import_flight(log: Path, robot: str | None, lists: bool, as_json: bool, **options: Any) -> None:
    """Make a flight that exists into a response of its robot, as if it had been tested.

    \b
    FILE is
      a rosbag2 folder, .mcap, .db3    ROS 2     --reference /cmd.pose.position.x
      .ulg                             PX4       trajectory_setpoint.position[0]
      .bin, .log                       ArduPilot PSCN.TPN
      .tlog                            MAVLink   POSITION_TARGET_LOCAL_NED.x
      .csv, .tsv, .txt                 a table   the name of a column
    The response is known where the reference had power, and nothing is claimed elsewhere.
    `nufleet rank --reuse` counts it as evidence. A robot that is not in the repository describes
    itself: start its fleet, or name its --fleet.
    """
    from nufleet.orchestrator.jobs.import_flight import (
        ImportCommand,
        import_and_print,
        list_and_print,
    )

    if lists:
        refuse_in_vain("with --list", *(typed_options().keys() - {"log", "lists", "as_json"}))
        list_and_print(log, as_json=as_json)
        return
    if robot is None:
        raise click.UsageError("which robot flew? Name it with --robot")
    import_and_print(ImportCommand(log=log, robot=robot, as_json=as_json, **options))
