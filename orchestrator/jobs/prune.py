"""The work of `nufleet runs prune`."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path

import click

from nufleet.orchestrator.history.catalogue import Damaged, Run, read_runs
from nufleet.orchestrator.history.pruning import Limits, RunOnDisk, beyond
from nufleet.orchestrator.jobs.commands import StoredCommand
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.runs.folder import (
    RECORDING,
    is_in_use,
    read_configuration,
    study_id_of,
)
from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.redaction import HIDDEN

PLOTS = "plots"

AGE_MAX_DAYS = 1e6
"""Age in days beyond which no run can be, and none is deleted for its age."""


@dataclass(frozen=True, kw_only=True)
class PruneCommand(StoredCommand):
    """The options of one `nufleet runs prune`."""

    days: float | None = None
    """Largest age of a run in days; None for no limit."""
    most: int | None = None
    """Largest number of runs; None for no limit."""
    megabytes: float | None = None
    """Largest size of all runs together in 10⁶ bytes; None for no limit."""
    keep_samples: bool = False
    """Whether only recordings and plots are deleted."""
    delete: bool = False
    """Whether to delete anything; otherwise it is only listed."""


def prune_and_print(command: PruneCommand) -> None:
    """Delete the runs that exceed the limits, or list them, and print what is deleted.

    Raises:
        InvalidInputError: No limit is given, or a folder cannot be deleted.
        RepositoryError: The samples in the repository cannot be deleted.
    """
    limits = Limits(
        None if command.days is None else timedelta(days=min(command.days, AGE_MAX_DAYS)),
        command.most,
        None if command.megabytes is None else round(1e6 * command.megabytes),
    )
    # A link may lead to a folder that others use.
    found = [run for run in read_runs(command.runs_root) if not run.folder.is_symlink()]
    pruned = beyond(
        limits, [_on_disk(run, command.keep_samples) for run in found], datetime.now(UTC)
    )
    samples = _delete(command, pruned) if command.delete else 0
    if command.as_json:
        entries = [{"run": str(run.folder), "size_bytes": run.freed_bytes} for run in pruned]
        document = {"schema": 1, "deleted": command.delete, "runs": entries, "samples": samples}
        click.echo(json.dumps(document))
        return
    for run in pruned:
        click.echo(f"{run.folder.name}  {run.freed_bytes / 1e6:.1f} MB", err=True)
    what = "recordings and plots of " if command.keep_samples else ""
    freed_mb = sum(run.freed_bytes for run in pruned) / 1e6
    total = f"{what}{len(pruned)} of {len(found)} runs, {freed_mb:.1f} MB"
    if not pruned:
        click.echo(
            f"nothing to delete: all {len(found)} runs are within the limits, may still "
            "continue, or hold nothing but what is kept",
            err=True,
        )
    elif command.delete:
        tests = "" if command.keep_samples else f", and the samples of {samples} tests"
        click.echo(f"deleted: {total}{tests}", err=True)
    else:
        click.echo(f"would be deleted: {total}; delete them with --delete", err=True)


def _on_disk(run: Run | Damaged, keep_samples: bool) -> RunOnDisk:
    size_bytes = _size_bytes([run.folder])
    if isinstance(run, Damaged):
        return RunOnDisk(run.folder, None, False, size_bytes, 0)
    freed_bytes = _size_bytes(_pictures(run.folder)) if keep_samples else size_bytes
    finished = run.result is not None and not is_in_use(run.folder)
    return RunOnDisk(run.folder, run.began, finished, size_bytes, freed_bytes)


def _pictures(folder: Path) -> list[Path]:
    return [path for path in (folder / RECORDING, folder / PLOTS) if path.exists()]


def _size_bytes(paths: Iterable[Path]) -> int:
    files = (file for path in paths for file in (path, *path.rglob("*")))
    return sum(file.lstat().st_size for file in files if not file.is_dir())


def _delete(command: PruneCommand, runs: list[RunOnDisk]) -> int:
    """Delete runs; return the number of tests whose samples the repositories do not hold any more.

    The repositories keep responses and trials, since later studies may reuse them.
    """
    kept_in = {} if command.keep_samples else {run.folder: _kept(command, run) for run in runs}
    forgotten = 0
    with system_errors_as(InvalidInputError, f"{command.runs_root} cannot be pruned"):
        # Pictures first: on a full disk, a repository needs the room that they take.
        for run in runs:
            for path in _pictures(run.folder):
                shutil.rmtree(path) if path.is_dir() else path.unlink()
        for storage in dict.fromkeys(kept_in.values()):
            with storage.open() as repository:
                for folder in (one for one, where in kept_in.items() if where == storage):
                    # The folder last: by it, what an interruption leaves is found again.
                    forgotten += repository.studies.forget_samples(study_id_of(folder))
                    shutil.rmtree(folder)
    return forgotten


def _kept(command: PruneCommand, run: RunOnDisk) -> Storage:
    """Return where the samples of a run are kept; raises InvalidInputError where that is not known,
    as a password is not written down."""
    configuration = read_configuration(run.folder)
    of_run = Storage.of_run(command.runs_root, configuration)
    if "repository" not in configuration or of_run.name == command.storage.name:
        return command.storage
    if HIDDEN in of_run.name or not of_run.exists:
        raise InvalidInputError(
            f"the samples of {run.folder.name} are in {of_run.name}, which cannot be opened like "
            "this: name it with --repository, or add --keep-samples"
        )
    return of_run
