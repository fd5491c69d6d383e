"""`nufleet runs`: list, show, export, resume and prune earlier runs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    json_option,
    live_option,
    moving_options,
    recording_option,
    rehearsal_option,
    runs_option,
    storage_options,
    wait_option,
)
from nufleet.orchestrator.cli.types import PositiveNumber, RunName
from nufleet.shared.command_line import folder_option


@click.command("list")
@runs_option
@json_option
def list_runs(runs_root: Path, as_json: bool) -> None:
    """List earlier runs, the newest last."""
    from nufleet.orchestrator.jobs.run_list import list_and_print

    list_and_print(runs_root, as_json=as_json)


@click.command()
@click.argument("run", type=RunName(), default="latest")
@click.option(
    "--connect",
    metavar="ENDPOINT",
    help="Router of the fleet.  [default: the one that the run used, or its own fleet restarted]",
)
@wait_option("How long to wait for the router and the robots.")
@moving_options
@rehearsal_option
@live_option
@recording_option
@storage_options
def resume(**options: Any) -> None:
    """Resume the interrupted ranking or evaluation RUN: a folder, its name, or `latest`.

    Tests and flights that were completed are not repeated. If a test was in progress, the robot is
    asked how it ended: it counts if it was completed, and is repeated otherwise. For robots that
    respond reproducibly, the result is the same as without the interruption.
    """
    from nufleet.orchestrator.jobs.resume import ResumeCommand, resume_and_print

    resume_and_print(ResumeCommand(**options))


@click.command()
@click.argument("run", type=RunName(), default="latest")
@runs_option
@json_option
def show(run: str, runs_root: Path, as_json: bool) -> None:
    """Show the results of RUN: a folder, its name, or `latest`."""
    from nufleet.orchestrator.jobs.runs import show_and_print

    show_and_print(runs_root, run, as_json=as_json)


@click.command()
@click.argument("first", type=RunName(), metavar="RUN")
@click.argument("second", type=RunName(), metavar="RUN", default="latest")
@runs_option
@json_option
def compare(first: str, second: str, runs_root: Path, as_json: bool) -> None:
    """Compare two runs: what was set differently, and how far their results are apart.

    Sources that both ranked are compared by ψ*, and flights of the same robot along the same path
    by their errors. The second RUN is the latest unless it is named.

    \b
    nufleet runs compare 20260102T120000Z-lab latest
    """
    from nufleet.orchestrator.jobs.runs import compare_and_print

    compare_and_print(runs_root, first, second, as_json=as_json)


@click.command()
@click.argument("run", type=RunName(), default="latest")
@folder_option(
    "--to",
    help="Folder for the files, one per robot.  [default: `responses` in the run's folder]",
)
@click.option(
    "--format", "suffix", type=click.Choice(["json", "csv"]), default="json", show_default=True
)
@storage_options
def export(**options: Any) -> None:
    """Write the responses that RUN measured to files: a folder, its name, or `latest`.

    Each file holds the response z(ω) of one robot with its variance, from all its usable tests.
    `nufleet gap` compares two such files; for python-control, real + 1j imag and omega_rad_s make a
    FrequencyResponseData. An interrupted run exports the responses that it has stored.

    \b
    nufleet runs export latest --to responses
    nufleet gap responses/target.json responses/source-2.json
    """
    from nufleet.orchestrator.jobs.runs import export_and_print

    export_and_print(**options)


@click.command()
@click.option("--days", type=PositiveNumber(), metavar="DAYS", help="Largest age of a run.")
@click.option("--most", type=click.IntRange(min=0), metavar="N", help="Largest number of runs.")
@click.option(
    "--megabytes", type=PositiveNumber(), metavar="MB", help="Largest size of all runs together."
)
@click.option(
    "--keep-samples", is_flag=True, help="Delete only the recordings and the plots of these runs."
)
@click.option("--delete", is_flag=True, help="Delete these runs; otherwise they are only listed.")
@storage_options
def prune(**options: Any) -> None:
    """List or delete the oldest runs, until the rest is within all limits.

    The raw samples of a deleted run are deleted from the repository, too. The responses estimated
    from them stay there, so that rankings can reuse them. A run without a result is never deleted:
    it may still be running, or be resumed. SQLite fills the freed space with later runs; the file
    does not shrink.

    \b
    nufleet runs prune --days 30
    nufleet runs prune --days 30 --megabytes 2000 --delete
    """
    from nufleet.orchestrator.jobs.prune import PruneCommand, prune_and_print

    prune_and_print(PruneCommand(**options))
