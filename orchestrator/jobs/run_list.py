"""The work of `nufleet runs list`.

It opens no repository unless an unfinished run of an older version may be in it, and never connects
to a fleet.
"""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import click
from rich.table import Table

from nufleet.orchestrator.history.listing import ListedRun, listed_runs
from nufleet.orchestrator.jobs.terminal import stdout_console
from nufleet.orchestrator.runs.folder import study_id_of

INTERRUPTED = "interrupted, or still running"


def list_and_print(runs_root: Path, *, as_json: bool) -> None:
    """Print a list of all runs, the newest last.

    Args:
        runs_root: Folder that holds the folders of all runs.
        as_json: Whether to print the list as JSON on stdout instead of a table.
    """
    runs = listed_runs(runs_root)
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
    untold = [run.folder for run in runs if not (run.told or run.headline.results)]
    unfinished = why_unfinished(runs_root, untold)
    for run in runs:
        table.add_row(run.folder.name, run.kind, _said(run, unfinished))
    stdout_console().print(table)


def _said(run: ListedRun, unfinished: dict[Path, str]) -> str:
    headline = run.headline
    if run.damage:
        return f"[red]{run.damage}[/]"
    if headline.results:
        return headline.text
    failed = f"failed: {headline.failure}" if headline.failure else INTERRUPTED
    return f"[yellow]{unfinished.get(run.folder, failed)}[/]"


def why_unfinished(runs_root: Path, folders: Iterable[Path]) -> dict[Path, str]:
    """Return why each run has no result, as far as the repository in `runs_root` knows it.

    Args:
        runs_root: Folder that holds the folders of all runs.
        folders: Folders of runs without a result.

    Returns:
        The reason in words, by the run's folder.
    """
    found = dict.fromkeys(folders, INTERRUPTED)
    if not found:
        return found
    from nufleet.orchestrator.jobs.storage import Storage
    from nufleet.orchestrator.repository.address import FILE_NAME
    from nufleet.orchestrator.repository.records import StudyStatus

    if (runs_root / FILE_NAME).exists():
        with Storage(runs_root).open() as repository:
            failed = repository.studies.studies(StudyStatus.FAILED)
        reasons = {study.study_id: f"failed: {study.reason}" for study in failed}
        found |= {f: reasons[study_id_of(f)] for f in found if study_id_of(f) in reasons}
    return found


def result_document(folder: Path, results: str) -> dict[str, Any]:
    """Return the document that a run left, with a result of None when the run did not finish.

    Args:
        folder: Folder of the run.
        results: Name of the file with its results; empty if there is none.
    """
    if not results:
        return {"run": str(folder), "result": None}
    document: dict[str, Any] = json.loads((folder / results).read_bytes())
    return document


def _document(run: ListedRun) -> dict[str, Any]:
    """Return the entry of a run in the list; the result of a ranking is the document it printed."""
    if run.damage:
        return {"run": str(run.folder), "result": None, "error": run.damage}
    full = result_document(run.folder, run.headline.results)
    return {
        "run": str(run.folder),
        "kind": run.kind,
        "fleet": run.fleet,
        "began": None if run.began is None else run.began.isoformat(),
        "headline": run.headline.text,
        "result": full.get("result", full),
    }
