"""`nufleet robot check` and `nufleet robot new`."""

from __future__ import annotations

from pathlib import Path

import click


@click.command()
@click.argument("target", metavar="DRIVER|FLEET")
@click.option("--robot", metavar="NAME", help="Robot of the fleet file.  [default: its first one]")
@click.option(
    "--settings",
    "settings_toml",
    default="",
    metavar="TOML",
    help="Settings of the driver, one `name = value` per line or separated by `;`.",
)
@click.option("--still", is_flag=True, help="Check only what moves nothing.")
@click.option("--kill", is_flag=True, help="Also cut the motors of a real robot while it moves.")
@click.option("--yes", is_flag=True, help="Move a real robot without asking.")
@click.option("--json", "as_json", is_flag=True, help="Print the report as JSON.")
def check(
    target: str,
    robot: str | None,
    settings_toml: str,
    still: bool,
    kill: bool,
    yes: bool,
    as_json: bool,
) -> None:
    """Check whether a robot's driver keeps the contract of a robot, and say what to mend.

    DRIVER is the name of an installed driver; FLEET is a fleet file, or the name of an installed
    one. The robot moves by a fifth of its amplitude limit, slowly. Ends with exit code 1 when a
    statement of the contract does not hold.
    """
    from nufleet.robot_agent.driver_kit.check import check_robot
    from nufleet.robot_agent.driver_kit.subject import AMPLITUDE_SHARE
    from nufleet.robot_agent.driver_kit.subject_file import robot_to_check
    from nufleet.shared.command_line import ask_before, restart_within

    name, needed, build = robot_to_check(target, robot, settings_toml)
    restart_within(needed)
    built = build()
    if not (built.spec.simulated or still or yes):
        axes = ", ".join(
            f"{AMPLITUDE_SHARE * axis.amplitude_max:.2g} {axis.unit} on {axis.name}"
            for axis in built.spec.axes
        )
        ask_before(
            f"{name} is real: it will take off if it flies, and move by {axes}",
            instead="--still to move nothing",
        )
    try:
        report = check_robot(built, name=name, moves=not still, cuts=True if kill else None)
    except KeyboardInterrupt as interrupt:
        click.echo(str(interrupt), err=True)
        raise
    if as_json:
        click.echo(report.document())
    else:
        click.echo(str(report))
        held = sum(one.holds is True for one in report.examined)
        click.echo(f"{held} of {len(report.examined)} statements hold for {name}", err=True)
    if report.failed:
        raise click.exceptions.Exit(1)


@click.command()
@click.argument("name")
@click.option(
    "--folder",
    type=click.Path(file_okay=False, path_type=Path),
    help="Folder to make.  [default: nufleet-NAME]",
)
def new(name: str, folder: Path | None) -> None:
    """Write a package with a driver called NAME, its fleet file and its test.

    The package works as it is: `pip install -e FOLDER`, then `nufleet robot check NAME` and
    `nufleet rank --fleet FOLDER/fleet.toml`. Replace its simulated cart by your robot.
    """
    from nufleet.robot_agent.driver_kit.new_package import write_package

    folder = folder or Path(f"nufleet-{name.replace('_', '-')}")
    write_package(name, folder)
    click.echo(
        f"""{folder} holds a driver that works as it is. Next:
  pip install -e {folder}
  nufleet robot check {name}
  nufleet rank --fleet {folder}/fleet.toml"""
    )
