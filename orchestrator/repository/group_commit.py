"""Commits what several threads write at the same time together, so that they share one wait.

A commit waits for the disk for milliseconds, and a fleet's robots answer by the hundred: while one
thread commits, the others gather, and the next of them commits what has gathered.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from typing import Protocol

from sqlalchemy import Connection

from nufleet.orchestrator.repository.errors import RepositoryError

Work = Callable[[Connection], None]


class Transactions(Protocol):
    """What commits: a database."""

    def write(self) -> AbstractContextManager[Connection]:
        """A transaction, on disk when it has been left."""

    def savepoint(self, connection: Connection) -> AbstractContextManager[None]:
        """A part of one, undone alone when it is left by an error."""


@dataclass(eq=False)
class _Job:
    """Work and what came of it, which is an error until it is known to be on disk."""

    work: Work
    done: bool = False
    error: Exception | None = field(
        default_factory=lambda: RepositoryError(
            "the thread that was storing this was interrupted: it may not be stored"
        )
    )


class GroupCommit:
    """Shared by all threads that write to one database."""

    def __init__(self, database: Transactions) -> None:
        self._database = database
        self._gathering = threading.Lock()
        self._committing = threading.Lock()
        self._jobs: list[_Job] = []

    def run(self, work: Work) -> None:
        """Do some work and return when it is on disk; raise what it raised, and then undo it."""
        job = _Job(work)
        with self._gathering:
            self._jobs.append(job)
        with self._committing:
            if not job.done:
                with self._gathering:
                    jobs, self._jobs = self._jobs, []
                self._commit(jobs)
        if job.error is not None:
            raise job.error

    def _commit(self, jobs: list[_Job]) -> None:
        errors: list[Exception | None]
        try:
            with self._database.write() as connection:
                errors = [self._try(job, connection) for job in jobs]
        except Exception as error:  # noqa: BLE001 - each thread raises it where it wrote
            # Nothing of it is on disk, whatever each part came to.
            errors = [error] * len(jobs)
        for job, outcome in zip(jobs, errors, strict=True):
            job.error, job.done = outcome, True

    def _try(self, job: _Job, connection: Connection) -> Exception | None:
        try:
            with self._database.savepoint(connection):
                job.work(connection)
        except Exception as error:  # noqa: BLE001 - its own thread raises it
            return error
        return None
