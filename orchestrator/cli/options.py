"""Options that several commands share."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

from nufleet.orchestrator.environment import REPOSITORY_VARIABLE, ROUTER_VARIABLE, RUNS_VARIABLE


class PositiveNumber(click.ParamType[float]):
    """A finite number above zero, within optional bounds; other values are refused in words."""

    name = "number"

    def __init__(self, low: float | None = None, high: float | None = None) -> None:
        self._low, self._high = low, high

    def convert(
        self, value: object, param: click.Parameter | None, ctx: click.Context | None
    ) -> float:
        """Return the number; reports an invalid one as click does, by raising its usage error."""
        try:
            number = float(str(value))
        except ValueError:
            self.fail(f"{value!r} is not a number", param, ctx)
        if not 0 < number < math.inf:
            self.fail(f"{value} must be a number above 0, and finite", param, ctx)
        low, high = self._low or 0.0, self._high or math.inf
        if not low <= number <= high:
            self.fail(f"{value} must be between {low:g} and {high:g}", param, ctx)
        return number


F = TypeVar("F", bound=Callable[..., Any])


def connect_options(command: F) -> F:
    """Add --connect and --fleet-name."""
    name = click.option(
        "--fleet-name",
        metavar="NAME",
        help="Which fleet at that router.  [default: the only one there is]",
    )
    connect = click.option(
        "--connect",
        default="tcp/127.0.0.1:7447",
        show_default=True,
        envvar=ROUTER_VARIABLE,
        metavar="ENDPOINT",
        help="The router of a running fleet.  [env: NUFLEET_ROUTER]",
    )
    return connect(name(command))


def runs_option(command: F) -> F:
    """Add --runs."""
    return click.option(
        "--runs",
        "runs_root",
        type=click.Path(file_okay=False, path_type=Path),
        default=Path("runs"),
        show_default=True,
        envvar=RUNS_VARIABLE,
        help="Where runs leave their folders.  [env: NUFLEET_RUNS]",
    )(command)


def repository_option(command: F) -> F:
    """Add --repository."""
    return click.option(
        "--repository",
        metavar="URL",
        envvar=REPOSITORY_VARIABLE,
        help=(
            "The database that keeps robots, studies and responses: a file, or "
            "postgresql://USER@HOST/DATABASE, with its password in the file that PGPASSFILE names, "
            "where no other user sees it.  [default: nufleet.sqlite in the folder of --runs; "
            "env: NUFLEET_REPOSITORY]"
        ),
    )(command)


def json_option(command: F) -> F:
    """Add --json."""
    return click.option(
        "--json", "as_json", is_flag=True, help="Print one JSON document on stdout, alone."
    )(command)


def live_option(command: F) -> F:
    """Add --live."""
    return click.option(
        "--live",
        is_flag=True,
        help="Serve the recording meanwhile: `nufleet view --live`.",
    )(command)


def fleet_option(command: F) -> F:
    """Add --fleet."""
    return click.option(
        "--fleet",
        "fleet_file",
        metavar="FILE",
        help="Start the simulated fleet of this file (or installed name) for this command alone.",
    )(command)


def drawing_robots_options(command: F) -> F:
    """Add --fleet, --connect, --fleet-name and --robot: the robots whose limits count."""
    robots = click.option(
        "--robot",
        "robots",
        multiple=True,
        metavar="NAME",
        help=(
            "By whose limits; may be given several times.  [default: with --fleet all robots of "
            "it, else those of the simulated quadrotors]"
        ),
    )
    return fleet_option(connect_options(robots(command)))


def overwriting_option(command: F) -> F:
    """Add --force."""
    return click.option("--force", is_flag=True, help="Replace a file that is there.")(command)
