"""`nufleet runs`: list what earlier runs left behind, show it, and go on with it."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import json_option, repository_option, runs_option


@click.command("list")
@runs_option
@json_option
def list_runs(runs_root: Path, as_json: bool) -> None:
    """List earlier runs, the newest last."""
    import json

    from rich.table import Table

    from orchestrator.console import stderr_console
    from orchestrator.run_folder import RESULTS, read_record
    from orchestrator.run_folder import list_runs as folders

    table = Table()
    for heading in ("run", "target", "selected", "ψ*", "iterations"):
        table.add_column(heading)
    documents: list[dict[str, object]] = []
    for folder in folders(runs_root):
        if not (folder / RESULTS).exists():
            table.add_row(folder.name, "", "[yellow]no result: interrupted or failed[/]")
            documents.append({"run": str(folder), "result": None})
            continue
        result = read_record(folder).result
        psi = f"{result.ranking[0].psi:.4f} ± {result.ranking[0].psi_std:.4f}"
        table.add_row(folder.name, result.target, result.selected, psi, str(result.iterations))
        document = result.model_dump(mode="json", by_alias=True, exclude_none=True)
        documents.append({"run": str(folder), "result": document})
    if as_json:
        click.echo(json.dumps({"schema": 1, "runs": documents}))
    elif documents:
        stderr_console().print(table)
    else:
        click.echo(f"no runs in {runs_root}", err=True)


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
    result is that of the undisturbed run, for robots that answer the same question alike.
    """
    from orchestrator.cli.resume_session import ResumeCommand, resume_and_print

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
    """Show the result of RUN: a folder, its name, or `latest`."""
    from orchestrator.console import ranking_table, stderr_console
    from orchestrator.run_folder import find_run, read_record
    from orchestrator.verdict_table import print_verdicts
    from shared.command_line import invocation

    folder = find_run(runs_root, run)
    record = read_record(folder)
    if as_json:
        click.echo(record.model_dump_json(by_alias=True, exclude_none=True))
        return
    console = stderr_console()
    low, high = record.result.band_rad_s
    console.print(
        f"[bold]{folder.name}[/]: target {record.result.target}, axis {record.axis}, "
        f"band {low:g} to {high:g} rad/s, seed {record.seed}"
    )
    console.print(ranking_table(record.result.ranking, record.closed_form))
    print_verdicts(console, record.result)
    for robot, reason in record.dropped.items():
        console.print(f"[red]without {robot}: {reason}[/]")
    console.print(f"files: {', '.join(sorted(p.name for p in folder.iterdir()))}")
    console.print(f"open the recording with:  {invocation()} view {folder}")
