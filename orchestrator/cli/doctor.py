"""`nufleet doctor`: check that everything that nufleet needs is installed and works."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import connect_options, json_option


@click.command()
@connect_options
@json_option
def doctor(**options: Any) -> None:
    """Check versions, ports, the viewer and the router, and report what is missing.

    Ends with exit code 1 when something that `nufleet demo` needs is missing; a router that is not
    running does not count.
    """
    from nufleet.orchestrator.jobs.doctor import checkup_and_print

    if not checkup_and_print(**options):
        raise click.exceptions.Exit(1)
