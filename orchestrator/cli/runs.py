"""`nufleet runs`: list, show, export and resume earlier runs."""

from __future__ import annotations

from pathlib import Path

import click

from nufleet.orchestrator.cli.options import json_option, repository_option, runs_option


@click.command("list")
@runs_option
@json_option
def list_runs(runs_root: Path, as_json: bool) -> None:
    """List earlier runs, the newest last."""
    from nufleet.orchestrator.jobs.runs import list_and_print

    list_and_print(runs_root, as_json=as_json)


@click.command()
@click.argument("run", default="latest")
@click.option(
    "--connect",
    metavar="ENDPOINT",
    help="The router of the fleet.  [default: as the run did; a fleet of its own starts again]",
)
@click.option(
    "--wait",
    "wait_s",
    type=click.FloatRange(min=0),
    default=0.0,
    metavar="SECONDS",
    help="How long to wait for the router and the robots.",
)
@click.option(
    "--live",
    is_flag=True,
    help="Serve the recording while the study runs; `nufleet view --live` shows it.",
)
@runs_option
@repository_option
@json_option
def resume(
    run: str,
    connect: str | None,
    wait_s: float,
    live: bool,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Go on with RUN, which was interrupted: a folder, its name, or `latest`.

    What was measured is not flown again. A motion that was in progress is asked for by its id: it
    counts if it was completed, and is repeated if it ended with the process that commanded it. The
    result equals that of an undisturbed run, if the robots answer equal requests equally.
    """
    from nufleet.orchestrator.jobs.resume import ResumeCommand, resume_and_print

    resume_and_print(
        ResumeCommand(
            run=run,
            connect=connect,
            wait_s=wait_s,
            live=live,
            runs_root=runs_root,
            repository=repository,
            as_json=as_json,
        )
    )


@click.command()
@click.argument("run", default="latest")
@runs_option
@json_option
def show(run: str, runs_root: Path, as_json: bool) -> None:
    """Show what RUN came to: a folder, its name, or `latest`."""
    from nufleet.orchestrator.jobs.runs import show_and_print

    show_and_print(runs_root, run, as_json=as_json)


@click.command()
@click.argument("run", default="latest")
@click.option(
    "--to",
    type=click.Path(file_okay=False, path_type=Path),
    metavar="FOLDER",
    help="Where the files go, one for each robot.  [default: `responses` in the run's folder]",
)
@click.option(
    "--format",
    "suffix",
    type=click.Choice(["json", "csv"]),
    default="json",
    show_default=True,
)
@runs_option
@repository_option
@json_option
def export(
    run: str,
    to: Path | None,
    suffix: str,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Write the responses that RUN measured to files: a folder, its name, or `latest`.

    Each holds one robot's z(ω) with its variance, all its usable tests together. `nufleet gap`
    compares two of them; python-control takes real + 1j imag and omega_rad_s for a
    FrequencyResponseData. An interrupted run gives the responses that it stored.

    \b
    nufleet runs export latest --to responses
    nufleet gap responses/target.json responses/source-2.json
    """
    from nufleet.orchestrator.jobs.runs import export_and_print

    export_and_print(runs_root, run, to, suffix, repository, as_json=as_json)
