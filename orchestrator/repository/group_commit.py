"""Commits simultaneous writes of several threads together, so that they share one disk wait.

A commit waits milliseconds for the disk, and hundreds of robots may answer at once. While one
thread commits, the writes of the others accumulate; the next thread commits all of them. Writes
that come one after the other, since what is written is computed one at a time, are announced, and a
commit waits a moment for them.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass, field
from typing import Protocol

from sqlalchemy import Connection

from nufleet.orchestrator.repository.errors import RepositoryError

PATIENCE_S = 0.05
"""Longest time in s that a commit waits for work that is announced."""

ENOUGH = 8
"""Number of writes that share a commit without waiting for more."""

Work = Callable[[Connection], None]


class Transactions(Protocol):
    """A database's transactions."""

    def write(self) -> AbstractContextManager[Connection]:
        """Open a transaction that is on disk when the context has been left."""

    def savepoint(self, connection: Connection) -> AbstractContextManager[None]:
        """Open a part of a transaction, which alone is undone on an error."""


@dataclass(eq=False)
class _Job:
    """Work and its outcome, which counts as an error until the work is known to be on disk."""

    work: Work
    done: bool = False
    error: Exception | None = field(
        default_factory=lambda: RepositoryError(
            "the thread that was storing this was interrupted: it may not be stored"
        )
    )


class GroupCommit:
    """The common commit of all threads that write to one database."""

    def __init__(self, database: Transactions) -> None:
        self._database = database
        self._gathering = threading.Condition()
        self._announced = 0
        self._committing = threading.Lock()
        self._jobs: list[_Job] = []

    @contextmanager
    def announced(self) -> Iterator[None]:
        """Prepare some work in this context, so that commits wait a moment for it."""
        with self._gathering:
            self._announced += 1
        try:
            yield
        finally:
            with self._gathering:
                self._announced -= 1  # without a notice: the work follows at once

    def run(self, work: Work) -> None:
        """Run some work and return when it is on disk; if it raises an error, undo it and raise.

        It may be run twice, the first time undone, because the work of others raised an error.
        """
        job = _Job(work)
        with self._gathering:
            self._jobs.append(job)
            self._gathering.notify_all()
        with self._committing:
            if not job.done:
                with self._gathering:
                    self._gathering.wait_for(self._are_enough, PATIENCE_S)
                    jobs, self._jobs = self._jobs, []
                self._commit(jobs)
        if job.error is not None:
            raise job.error

    def _are_enough(self) -> bool:
        return self._announced == 0 or len(self._jobs) >= ENOUGH

    def _commit(self, jobs: list[_Job]) -> None:
        errors: list[Exception | None] = [None] * len(jobs)
        try:
            with self._database.write() as connection:
                for job in jobs:
                    job.work(connection)
        except Exception as error:  # noqa: BLE001 - each thread raises it where it wrote
            errors = [error] if len(jobs) == 1 else self._commit_apart(jobs)
        for job, outcome in zip(jobs, errors, strict=True):
            job.error, job.done = outcome, True

    def _commit_apart(self, jobs: list[_Job]) -> list[Exception | None]:
        """Commit again what was undone together because of some of the work, which raised an error.

        Work is almost never refused, and a savepoint for each part costs as much as the part.
        """
        try:
            with self._database.write() as connection:
                return [self._try(job, connection) for job in jobs]
        except Exception as error:  # noqa: BLE001 - each thread raises it where it wrote
            # The common commit failed, so no part is on disk, even if its work succeeded.
            return [error] * len(jobs)

    def _try(self, job: _Job, connection: Connection) -> Exception | None:
        try:
            with self._database.savepoint(connection):
                job.work(connection)
        except Exception as error:  # noqa: BLE001 - its own thread raises it
            return error
        return None
