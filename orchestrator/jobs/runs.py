"""The work of `nufleet runs list`, `show` and `export`."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from nufleet.orchestrator.history.catalogue import KINDS, Damaged, Run, read_run, read_runs
from nufleet.orchestrator.history.export import export_responses, run_responses
from nufleet.orchestrator.history.tables import run_tables
from nufleet.orchestrator.jobs.resume import can_reach_again
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.repository.database import FILE_NAME
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.runs.console import stderr_console
from nufleet.orchestrator.runs.folder import RECORDING, find_run, study_id_of
from nufleet.shared.command_line import invocation

INTERRUPTED = "interrupted, or not over yet"


def list_and_print(runs_root: Path, *, as_json: bool) -> None:
    """Print a list of all runs, the newest last.

    Args:
        runs_root: Folder that holds the folders of all runs.
        as_json: Whether to print the list as JSON on stdout instead of a table on stderr.
    """
    runs = read_runs(runs_root)
    if as_json:
        documents = [_document(run) for run in runs]
        click.echo(json.dumps({"schema": 1, "runs": documents}))
        return
    if not runs:
        click.echo(f"no runs in {runs_root}", err=True)
        return
    table = Table()
    # There is no column for the fleet, which the run's name begins with. Other commands take the
    # name as an argument, so it is never truncated.
    table.add_column("run", no_wrap=True, min_width=42)
    table.add_column("kind", no_wrap=True)
    table.add_column("what it came to", min_width=20)
    open_runs = [run for run in runs if isinstance(run, Run) and run.result is None]
    unfinished = _unfinished(runs_root, open_runs)
    for run in runs:
        if isinstance(run, Damaged):
            table.add_row(run.folder.name, "", f"[red]{run.reason}[/]")
        else:
            said = run.headline or f"[yellow]{unfinished[run.folder]}[/]"
            table.add_row(run.folder.name, run.kind, said)
    stderr_console().print(table)


def show_and_print(runs_root: Path, name: str, *, as_json: bool) -> None:
    """Print one run: its tables, its files, and the commands that resume it or open its recording.

    Args:
        runs_root: Folder that holds the folders of all runs.
        name: Name of the run, path of its folder, or `latest`.
        as_json: Whether to print the run's document as JSON on stdout instead of tables on stderr.
    """
    run = read_run(find_run(runs_root, name))
    if as_json:
        click.echo(json.dumps(_full(run)))
        return
    console = stderr_console()
    began = "" if run.began is None else f", begun {run.began:%Y-%m-%d %H:%M} UTC"
    console.print(f"[bold]{run.folder.name}[/]: {run.kind} of fleet {run.fleet}{began}")
    for part in run_tables(run):
        console.print(part)
    if run.result is None:
        why = _unfinished(runs_root, [run])[run.folder]
        console.print(f"[yellow]{why}[/]")
        if can_reach_again(run.folder) and why == INTERRUPTED:
            command = Storage(runs_root).resume_command(run.folder.name)
            console.print(f"it can go on where it was:  {command}")
    console.print(f"files: {', '.join(sorted(p.name for p in run.folder.iterdir()))}")
    if (run.folder / RECORDING).exists():
        console.print(f"open the recording with:  {invocation()} view {run.folder}")


def export_and_print(
    runs_root: Path,
    name: str,
    to: Path | None,
    suffix: str,
    repository: str | None,
    *,
    as_json: bool,
) -> None:
    """Export the responses of a run, and print the paths of the files; see `export`.

    Args:
        as_json: Whether to print the paths as JSON on stdout.
    """
    written = export(runs_root, name, to, suffix, repository)
    if as_json:
        paths = {robot: str(path) for robot, path in written.items()}
        click.echo(json.dumps({"schema": 1, "responses": paths}))
        return
    for robot, path in written.items():
        stderr_console().print(f"{robot}: {path}")


def export(
    runs_root: Path, name: str, to: Path | None, suffix: str, repository: str | None
) -> dict[str, Path]:
    """Write the responses of a run to files, and return the path of each robot's file, by robot.

    Args:
        runs_root: Folder that holds the folders of all runs.
        name: Name of the run, path of its folder, or `latest`.
        to: Folder to write to; None for `responses` in the run's folder.
        suffix: Suffix of the files, `json` or `csv`, which selects their format.
        repository: Address of the repository; None for the one in `runs_root`.
    """
    folder = find_run(runs_root, name)
    responses = run_responses(folder, Storage(runs_root, repository).open)
    return export_responses(responses, to or folder / "responses", suffix)


def _unfinished(runs_root: Path, runs: list[Run]) -> dict[Path, str]:
    """Return the reason why each run has no result, as far as their own repository knows it."""
    found = {run.folder: INTERRUPTED for run in runs}
    if runs and (runs_root / FILE_NAME).exists():
        with Storage(runs_root).open() as repository:
            failed = repository.studies.studies(StudyStatus.FAILED)
        reasons = {study.study_id: f"failed: {study.reason}" for study in failed}
        found |= {f: reasons[study_id_of(f)] for f in found if study_id_of(f) in reasons}
    return found


def _document(run: Run | Damaged) -> dict[str, Any]:
    """Return the entry of a run in the list; the result of a ranking is the document it printed."""
    if isinstance(run, Damaged):
        return {"run": str(run.folder), "result": None, "error": run.reason}
    full = _full(run)
    return {
        "run": str(run.folder),
        "kind": run.kind,
        "fleet": run.fleet,
        "began": None if run.began is None else run.began.isoformat(),
        "headline": run.headline,
        "result": full.get("result", full) if run.result is not None else None,
    }


def _full(run: Run) -> dict[str, Any]:
    """Return the document that a run left, with a result of None when the run did not finish."""
    if run.result is None:
        return {"run": str(run.folder), "result": None}
    document: dict[str, Any] = json.loads((run.folder / KINDS[run.kind].document).read_bytes())
    return document
