"""The work of `nufleet runs prune`."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

import click

from nufleet.orchestrator.history.catalogue import Damaged, Run, read_runs
from nufleet.orchestrator.history.pruning import Limits, RunOnDisk, beyond
from nufleet.orchestrator.jobs.commands import StoredCommand
from nufleet.orchestrator.runs.folder import RECORDING, study_id_of
from nufleet.shared.errors import InvalidInputError, system_errors_as

PLOTS = "plots"


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
        None if command.days is None else timedelta(days=command.days),
        command.most,
        None if command.megabytes is None else round(1e6 * command.megabytes),
    )
    # A link may lead to a folder that others use.
    found = [run for run in read_runs(command.runs_root) if not run.folder.is_symlink()]
    pruned = beyond(limits, [_on_disk(run) for run in found], datetime.now(UTC))
    samples = _delete(command, pruned) if command.delete else 0
    if command.as_json:
        entries = [{"run": str(run.folder), "size_bytes": run.size_bytes} for run in pruned]
        document = {"schema": 1, "deleted": command.delete, "runs": entries, "samples": samples}
        click.echo(json.dumps(document))
        return
    for run in pruned:
        click.echo(f"{run.folder.name}  {run.size_bytes / 1e6:.1f} MB", err=True)
    total = f"{len(pruned)} of {len(found)} runs, {sum(r.size_bytes for r in pruned) / 1e6:.1f} MB"
    if not pruned:
        click.echo(f"nothing to delete: all {len(found)} runs are within the limits", err=True)
    elif command.delete:
        click.echo(f"deleted: {total}, and the samples of {samples} tests", err=True)
    else:
        click.echo(f"would be deleted: {total}; delete them with --delete", err=True)


def _on_disk(run: Run | Damaged) -> RunOnDisk:
    files = [path.lstat() for path in run.folder.rglob("*")]
    size_bytes = sum(status.st_size for status in files)
    if isinstance(run, Damaged):
        return RunOnDisk(run.folder, None, False, size_bytes)
    return RunOnDisk(run.folder, run.began, run.result is not None, size_bytes)


def _delete(command: PruneCommand, runs: list[RunOnDisk]) -> int:
    """Delete runs; return the number of tests whose samples the repository does not hold any more.

    The repository keeps responses and trials, since later studies may reuse them.
    """
    forgotten = 0
    with system_errors_as(InvalidInputError, f"{command.runs_root} cannot be pruned"):
        if command.keep_samples:
            for run in runs:
                (run.folder / RECORDING).unlink(missing_ok=True)
                if (run.folder / PLOTS).exists():
                    shutil.rmtree(run.folder / PLOTS)
            return 0
        with command.storage.open() as repository:
            for run in runs:
                # The folder last: by it, what an interruption leaves is found again.
                forgotten += repository.studies.forget_samples(study_id_of(run.folder))
                shutil.rmtree(run.folder)
    return forgotten
