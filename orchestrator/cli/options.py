"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

import click
from click.core import ParameterSource

from nufleet.orchestrator.cli.types import FleetPath, NewPicture, Number, PositiveNumber
from nufleet.orchestrator.jobs.environment import (
    REPOSITORY_VARIABLE,
    ROUTER_VARIABLE,
    RUNS_VARIABLE,
)
from nufleet.shared.command_line import folder_option
from nufleet.shared.wire.identity import IDENTITY_VARIABLE
from nufleet.shared.wire.openness import LOCAL_ENDPOINT, OPEN_VARIABLE, chosen_address

F = TypeVar("F", bound=Callable[..., Any])


def typed_options() -> dict[str, str]:
    """Return the parameters that were typed in the command line, with the option of each."""
    context = click.get_current_context()
    return {
        parameter.name: parameter.opts[0]
        for parameter in context.command.params
        if context.get_parameter_source(parameter.name or "") is ParameterSource.COMMANDLINE
        and parameter.name is not None
    }


def refuse_in_vain(reason: str, *parameters: str) -> None:
    """Refuse the first of these parameters that was typed although it would have no effect.

    Args:
        reason: Circumstance in which they have none, such as "without --fleet".
        parameters: Names of parameters of the present command.
    """
    for name, option in typed_options().items():
        if name in parameters:
            raise click.UsageError(f"{option} has no effect {reason}; leave it out")


open_option = click.option(
    "--open",
    "allow_open",
    is_flag=True,
    envvar=OPEN_VARIABLE,
    help="Accept an address that every machine of the network can use without proof of who it is.  "
    "[env: NUFLEET_OPEN]",
)

_identity_option = click.option(
    "--identity",
    type=click.Path(dir_okay=False, path_type=Path),
    envvar=IDENTITY_VARIABLE,
    metavar="FILE",
    help="Identity in a closed fleet; names its router too.  [env: NUFLEET_IDENTITY; default: "
    "the only one in ~/.config/nufleet that is no robot's]",
)

_fleet_name_option = click.option(
    "--fleet-name",
    metavar="NAME",
    help="Name of the fleet at that router.  [default: the only one there]",
)

_connect_option = click.option(
    "--connect",
    envvar=ROUTER_VARIABLE,
    metavar="ENDPOINT",
    help="Router of a running open fleet.  [env: NUFLEET_ROUTER; default: tcp/127.0.0.1:7447]",
)


def connect_options(command: F) -> F:
    """Add --connect, --identity, --open and --fleet-name.

    The command is called with the address of the fleet as `connect`, and with `fleet_name`.
    """

    @wraps(command)
    def reached(
        *args: Any, connect: str | None, identity: Path | None, allow_open: bool, **options: Any
    ) -> Any:
        if options.get("fleet_file") is not None:
            reason = "with --fleet, which starts a fleet of its own"
            refuse_in_vain(reason, "connect", "identity", "allow_open", "fleet_name", "wait_s")
        else:
            connect = chosen_address(connect, identity, allow_open=allow_open)
        return command(*args, connect=connect or LOCAL_ENDPOINT, **options)

    return cast(F, address_options(reached))


def address_options(command: F) -> F:
    """Add the options of `connect_options` and pass them on as they were given."""
    return _connect_option(_identity_option(open_option(_fleet_name_option(command))))


def wait_option(help_text: str) -> Callable[[F], F]:
    """Return an option that adds --wait with a help text."""
    return click.option(
        "--wait",
        "wait_s",
        type=Number(0.0, unit="s"),
        default=0.0,
        metavar="SECONDS",
        help=help_text,
    )


runs_option = folder_option(
    "--runs",
    "runs_root",
    default=Path("runs"),
    show_default=True,
    envvar=RUNS_VARIABLE,
    help="Folder that holds the folders of all runs.  [env: NUFLEET_RUNS]",
)

repository_option = click.option(
    "--repository",
    metavar="URL",
    envvar=REPOSITORY_VARIABLE,
    help=(
        "Database that stores robots, studies and responses: a file, or "
        "postgresql://USER@HOST/DATABASE. Put the password into the file that PGPASSFILE "
        "names, where no other user can see it.  [default: nufleet.sqlite in the folder of "
        "--runs; env: NUFLEET_REPOSITORY]"
    ),
)

json_option = click.option(
    "--json", "as_json", is_flag=True, help="Print one JSON document on stdout, nothing else."
)


def storage_options(command: F) -> F:
    """Add --runs, --repository and --json."""
    return runs_option(repository_option(json_option(command)))


live_option = click.option(
    "--live",
    is_flag=True,
    help="Serve the recording during the run; `nufleet view --live` shows it.",
)

recording_option = click.option(
    "--no-recording",
    "draws",
    flag_value=False,
    default=True,
    help="Draw neither a recording nor plots, which saves processor time.",
)

rehearsal_option = click.option(
    "--no-rehearsal",
    "rehearses",
    flag_value=False,
    default=True,
    help="Do not wait for the errors that the target expects of its flights.",
)

unguarded_option = click.option(
    "--no-guard",
    "guarded",
    flag_value=False,
    default=True,
    help="Never fall back to the baseline; the robot's fleet file must allow this.",
)

_consent_options = (
    click.option(
        "--plan",
        "plans",
        is_flag=True,
        help="Print what each robot would do (how long, how far, how fast), and move none.",
    ),
    click.option(
        "--picture",
        type=NewPicture(),
        metavar="FILE",
        help="With --plan: draw it, as PNG, SVG or PDF.",
    ),
    click.option(
        "--yes/--confirm",
        "yes",
        default=None,
        help="Move robots without asking, as scripts must, or ask even if all are simulated.  "
        "[default: ask if a robot is real]",
    ),
)


def moving_options(command: F) -> F:
    """Add --plan, --picture, --yes and --confirm to a command that moves robots."""

    @wraps(command)
    def consistent(*args: Any, **options: Any) -> Any:
        if options["plans"]:
            refuse_in_vain("with --plan, which moves no robot", "live", "draws", "rehearses", "yes")
        else:
            refuse_in_vain("without --plan", "picture")
        return command(*args, **options)

    moving: Any = consistent
    for option in reversed(_consent_options):
        moving = option(moving)
    return cast(F, moving)


fleet_option = click.option(
    "--fleet",
    "fleet_file",
    type=FleetPath(),
    metavar="FILE",
    help="Start the simulated fleet of this file (or installed name) for this command only.",
)


realtime_option = click.option(
    "--realtime",
    type=PositiveNumber(),
    metavar="FACTOR",
    help="With --fleet: run at this multiple of real time.  [default: as fast as possible]",
)


def band_option(help_text: str) -> Callable[[F], F]:
    """Return an option that adds --band of a study with a help text."""
    return click.option(
        "--band",
        "band_rad_s",
        type=Number(unit="rad/s"),
        nargs=2,
        metavar="LOW HIGH",
        help=f"{help_text}, rad/s.  [default: from the fleet file, or what all robots accept]",
    )


def seed_option(help_text: str | None = None) -> Callable[[F], F]:
    """Return an option that adds --seed with a help text."""
    return click.option(
        "--seed", type=click.IntRange(min=0), default=0, show_default=True, help=help_text
    )


def drawing_robots_options(command: F) -> F:
    """Add --fleet, --connect, --fleet-name and --robot: the robots whose limits count."""
    robots = click.option(
        "--robot",
        "robots",
        multiple=True,
        metavar="NAME",
        help=(
            "Robot whose limits count; may be repeated.  [default: with --fleet all its robots, "
            "otherwise the limits of the simulated quadrotors]"
        ),
    )
    return fleet_option(connect_options(robots(command)))


def refuse_robots_in_vain(options: dict[str, Any]) -> None:
    """Refuse the address of a running fleet of which no robot is asked for its limits."""
    if options["fleet_file"] is None and not options["robots"]:
        refuse_in_vain("without --robot", "connect", "identity", "allow_open", "fleet_name")


overwriting_option = click.option("--force", is_flag=True, help="Replace an existing file.")
