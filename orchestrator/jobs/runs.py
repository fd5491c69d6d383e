"""The work of `nufleet runs show`, `compare` and `export`."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import click

from nufleet.orchestrator.history.catalogue import KINDS, read_run
from nufleet.orchestrator.history.comparison import compare_runs, comparison_parts
from nufleet.orchestrator.history.export import export_responses, run_responses
from nufleet.orchestrator.history.tables import run_tables
from nufleet.orchestrator.jobs.resume import can_reach_again
from nufleet.orchestrator.jobs.run_list import INTERRUPTED, result_document, why_unfinished
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.jobs.terminal import stdout_console
from nufleet.orchestrator.runs.folder import (
    RECORDING,
    find_run,
    is_in_use,
    read_configuration,
    study_id_of,
)
from nufleet.shared.command_line import invocation


def show_and_print(runs_root: Path, name: str, *, as_json: bool) -> None:
    """Print one run: its tables, its files, and the commands that resume it or open its recording.

    Args:
        runs_root: Folder that holds the folders of all runs.
        name: Name of the run, path of its folder, or `latest`.
        as_json: Whether to print the run's document as JSON on stdout instead of tables.
    """
    run = read_run(find_run(runs_root, name))
    if as_json:
        results = "" if run.result is None else KINDS[run.kind].document
        click.echo(json.dumps(result_document(run.folder, results)))
        return
    console = stdout_console()
    began = "" if run.began is None else f", begun {run.began:%Y-%m-%d %H:%M} UTC"
    console.print(f"[bold]{run.folder.name}[/]: {run.kind} of fleet {run.fleet}{began}")
    for part in run_tables(run):
        console.print(part)
    if run.result is None:
        for line in _unfinished(runs_root, run.folder):
            console.print(line)
    console.print(f"files: {', '.join(sorted(p.name for p in run.folder.iterdir()))}")
    if (run.folder / RECORDING).exists():
        console.print(f"open the recording with:  {invocation()} view {run.folder}")


def _unfinished(runs_root: Path, folder: Path) -> Iterator[str]:
    """Say why a run has no result, and how to continue it."""
    if is_in_use(folder):
        yield "[yellow]it is still running[/]"
        return
    why = why_unfinished(runs_root, [folder])[folder]
    configuration = read_configuration(folder)
    storage = Storage.of_run(runs_root, configuration)
    if configuration.get("kind", "rank") == "rank" and storage.lacks(study_id_of(folder)):
        yield "[yellow]it was interrupted before anything moved[/]: run it again"
        return
    yield f"[yellow]{why}[/]"
    if can_reach_again(folder):
        again = "it can be resumed where it stopped" if why == INTERRUPTED else "try it again"
        yield f"{again}:  {storage.resume_command(folder.name)}"


def compare_and_print(runs_root: Path, first: str, second: str, *, as_json: bool) -> None:
    """Print two runs side by side.

    Args:
        runs_root: Folder that holds the folders of all runs.
        first: Name of a run, path of its folder, or `latest`.
        second: The same of another run.
        as_json: Whether to print the comparison as JSON on stdout.
    """
    one, other = (find_run(runs_root, name) for name in (first, second))
    settings = read_configuration(one), read_configuration(other)
    found = compare_runs(read_run(one), read_run(other), settings)
    if as_json:
        click.echo(found.document())
        return
    for part in comparison_parts(found):
        stdout_console().print(part)


def export_and_print(
    *,
    run: str,
    to: Path | None,
    suffix: str,
    runs_root: Path,
    repository: str | None,
    as_json: bool,
) -> None:
    """Write the responses of a run to files, one per robot, and print the paths of the files.

    Args:
        run: Name of the run, path of its folder, or `latest`.
        to: Folder to write to; None for `responses` in the run's folder.
        suffix: Suffix of the files, `json` or `csv`, which selects their format.
        runs_root: Folder that holds the folders of all runs.
        repository: Address of the repository; None for the one in `runs_root`.
        as_json: Whether to print the paths as JSON on stdout.
    """
    folder = find_run(runs_root, run)
    responses = run_responses(folder, Storage(runs_root, repository).open)
    written = export_responses(responses, to or folder / "responses", suffix)
    if as_json:
        paths = {robot: str(path) for robot, path in written.items()}
        click.echo(json.dumps({"schema": 1, "responses": paths}))
        return
    for robot, path in written.items():
        stdout_console().print(f"{robot}: {path}")
