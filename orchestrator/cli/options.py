"""Options that several commands share."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, TypeVar

import click

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
        envvar="NUFLEET_ROUTER",
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
        envvar="NUFLEET_RUNS",
        help="Where runs leave their folders.  [env: NUFLEET_RUNS]",
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
