"""`nufleet doctor`: check that everything that nufleet needs is installed and works."""

from __future__ import annotations

import click

from nufleet.orchestrator.cli.options import connect_options, json_option


@click.command()
@connect_options
@json_option
def doctor(connect: str, fleet_name: str | None, as_json: bool) -> None:
    """Check versions, ports, the viewer and the router, and say what to do about what is missing.

    Ends with exit code 1 when something that `nufleet demo` needs is missing; that no router runs
    is no fault.
    """
    import json

    from nufleet.orchestrator.jobs.doctor import checkup

    findings = checkup(connect, fleet_name)
    if as_json:
        click.echo(json.dumps({"schema": 1, "checks": [finding.as_json() for finding in findings]}))
    else:
        for finding in findings:
            colour = {"ok": "green", "note": "yellow", "missing": "red"}[finding.verdict]
            click.secho(f"{finding.verdict:<8}", fg=colour, nl=False, err=True)
            click.echo(f"{finding.what}: {finding.found}", err=True)
    if any(finding.verdict == "missing" for finding in findings):
        raise click.exceptions.Exit(1)
