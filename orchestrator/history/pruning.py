"""Which earlier runs exceed the limits that a user sets on their age, number or size."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta
from pathlib import Path

from nufleet.shared.errors import InvalidInputError


@dataclass(frozen=True)
class RunOnDisk:
    """A run with what it occupies."""

    folder: Path
    """Folder of the run."""
    began: datetime | None
    """Time at which the run began, in UTC; None if it is not known."""
    finished: bool
    """Whether it has a result and no command works on it; any other may continue."""
    size_bytes: int
    """Size of its files."""
    freed_bytes: int
    """Size of those that pruning it deletes."""


@dataclass(frozen=True)
class Limits:
    """What the runs may be and occupy; None for no limit."""

    age: timedelta | None = None
    """Largest age of a run."""
    number: int | None = None
    """Largest number of runs."""
    size_bytes: int | None = None
    """Largest size of all runs together."""

    def __post_init__(self) -> None:
        if (self.age, self.number, self.size_bytes) == (None, None, None):
            raise InvalidInputError("no limit is given: add --days, --most or --megabytes")


def beyond(limits: Limits, runs: Sequence[RunOnDisk], now: datetime) -> list[RunOnDisk]:
    """Return the runs to be pruned so that the rest is within all limits, oldest first.

    Runs that are not finished count, but are never among them, nor are those that have nothing left
    to delete.

    Args:
        limits: Limits on age, number and size of the runs that stay.
        runs: All runs, oldest first.
        now: The present time, in UTC.
    """
    number, size_bytes = len(runs), sum(run.size_bytes for run in runs)
    pruned = []
    for run in runs:
        too_old = limits.age is not None and run.began is not None and now - run.began > limits.age
        too_many = limits.number is not None and number > limits.number
        too_large = limits.size_bytes is not None and size_bytes > limits.size_bytes
        if run.finished and (too_old or too_many or too_large):
            number, size_bytes = number - 1, size_bytes - run.freed_bytes
            if run.freed_bytes:
                pruned.append(run)
    return pruned
