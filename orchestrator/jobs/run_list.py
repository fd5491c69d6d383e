"""The work of `nufleet runs list`.

It opens no repository unless a run is unfinished, and never connects to a fleet.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from nufleet.orchestrator.history.catalogue import KINDS, Damaged, Run, read_runs
from nufleet.orchestrator.jobs.terminal import stdout_console
from nufleet.orchestrator.runs.folder import study_id_of

INTERRUPTED = "interrupted, or still running"


def list_and_print(runs_root: Path, *, as_json: bool) -> None:
    """Print a list of all runs, the newest last.

    Args:
        runs_root: Folder that holds the folders of all runs.
        as_json: Whether to print the list as JSON on stdout instead of a table.
    """
    runs = read_runs(runs_root)
    if as_json:
        click.echo(json.dumps({"schema": 1, "runs": [_document(run) for run in runs]}))
        return
    if not runs:
        click.echo(f"no runs in {runs_root}", err=True)
        return
    table = Table()
    # There is no column for the fleet, which the run's name begins with. Other commands take the
    # name as an argument, so it is never truncated.
    table.add_column("run", no_wrap=True, min_width=42)
    table.add_column("kind", no_wrap=True)
    table.add_column("result", min_width=20)
    open_runs = [run for run in runs if isinstance(run, Run) and run.result is None]
    unfinished = why_unfinished(runs_root, open_runs)
    for run in runs:
        if isinstance(run, Damaged):
            table.add_row(run.folder.name, "", f"[red]{run.reason}[/]")
        else:
            said = run.headline or f"[yellow]{unfinished[run.folder]}[/]"
            table.add_row(run.folder.name, run.kind, said)
    stdout_console().print(table)


def why_unfinished(runs_root: Path, runs: list[Run]) -> dict[Path, str]:
    """Return why each run has no result, as far as the repository in `runs_root` knows it.

    Args:
        runs_root: Folder that holds the folders of all runs.
        runs: Runs without a result.

    Returns:
        The reason in words, by the run's folder.
    """
    if not runs:
        return {}
    from nufleet.orchestrator.jobs.storage import Storage
    from nufleet.orchestrator.repository.address import FILE_NAME
    from nufleet.orchestrator.repository.records import StudyStatus

    found = {run.folder: INTERRUPTED for run in runs}
    if (runs_root / FILE_NAME).exists():
        with Storage(runs_root).open() as repository:
            failed = repository.studies.studies(StudyStatus.FAILED)
        reasons = {study.study_id: f"failed: {study.reason}" for study in failed}
        found |= {f: reasons[study_id_of(f)] for f in found if study_id_of(f) in reasons}
    return found


def full_document(run: Run) -> dict[str, Any]:
    """Return the document that a run left, with a result of None when the run did not finish."""
    if run.result is None:
        return {"run": str(run.folder), "result": None}
    document: dict[str, Any] = json.loads((run.folder / KINDS[run.kind].document).read_bytes())
    return document


def _document(run: Run | Damaged) -> dict[str, Any]:
    """Return the entry of a run in the list; the result of a ranking is the document it printed."""
    if isinstance(run, Damaged):
        return {"run": str(run.folder), "result": None, "error": run.reason}
    full = full_document(run)
    return {
        "run": str(run.folder),
        "kind": run.kind,
        "fleet": run.fleet,
        "began": None if run.began is None else run.began.isoformat(),
        "headline": run.headline,
        "result": full.get("result", full) if run.result is not None else None,
    }
