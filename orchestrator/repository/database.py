"""One database: its address, its connections and transactions, and its errors as typed ones."""

from __future__ import annotations

import os
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, closing, contextmanager, suppress
from importlib.util import find_spec
from typing import Any

from sqlalchemy import (
    URL,
    Connection,
    Engine,
    RowMapping,
    Select,
    create_engine,
    event,
    text,
)
from sqlalchemy.exc import DBAPIError, SQLAlchemyError

from nufleet.orchestrator.repository.address import shown
from nufleet.orchestrator.repository.errors import (
    RecordConflictError,
    RepositoryBusyError,
    RepositoryError,
    RepositoryFullError,
    RepositoryReadOnlyError,
    RepositoryUnreachableError,
    RepositoryUrlError,
    UnknownRecordError,
)
from nufleet.orchestrator.repository.group_commit import GroupCommit, Work

BUSY_S = 10.0
"""Time in s that a transaction waits for those of other processes."""

_WRITES = "nufleet_writes"
_Classes = tuple[tuple[str, type[RepositoryError]], ...]
_POSTGRESQL_CLASSES: _Classes = (
    ("53", RepositoryFullError),
    ("25006", RepositoryReadOnlyError),
    ("55P03", RepositoryBusyError),
    ("40", RepositoryBusyError),
    ("23503", UnknownRecordError),
    ("23", RecordConflictError),
    ("08", RepositoryUnreachableError),
    ("28", RepositoryUnreachableError),
    ("3D", RepositoryUnreachableError),
    ("57", RepositoryUnreachableError),
)
_SQLITE_CLASSES: _Classes = (
    ("SQLITE_FULL", RepositoryFullError),
    ("SQLITE_READONLY", RepositoryReadOnlyError),
    ("SQLITE_BUSY", RepositoryBusyError),
    ("SQLITE_CONSTRAINT_FOREIGNKEY", UnknownRecordError),
    ("SQLITE_CONSTRAINT", RecordConflictError),
    ("SQLITE_CANTOPEN", RepositoryUnreachableError),
    ("SQLITE_NOTADB", RepositoryUnreachableError),
    ("SQLITE_CORRUPT", RepositoryUnreachableError),
    ("SQLITE_IOERR", RepositoryUnreachableError),
)
_ADVICE = {
    RepositoryFullError: "free some space and resume the run",
    RepositoryReadOnlyError: "make it writable, or choose another repository",
    RepositoryBusyError: "another process holds it; try again when it has ended",
    RepositoryUnreachableError: "check the address, and that its server is running",
}


class Database:
    """The connections to one database, which must be closed; many threads may use it at once."""

    def __init__(self, url: URL) -> None:
        """Prepare; no connection is opened yet."""
        self.name = shown(url)
        self.is_sqlite = url.get_backend_name() == "sqlite"
        self._engine = _sqlite(url) if self.is_sqlite else _postgresql(url)
        self._group = GroupCommit(self)

    def close(self) -> None:
        """Close every connection."""
        self._engine.dispose()

    @contextmanager
    def read(self) -> Iterator[Connection]:
        """Open a transaction that only reads."""
        with self._named_errors(), self._engine.begin() as connection:
            yield connection

    @contextmanager
    def write(self) -> Iterator[Connection]:
        """Open a transaction that may write.

        It is committed and on disk when the context is left, or undone on an error.
        """
        writing = self._engine.execution_options(**{_WRITES: True})
        with self._named_errors(), writing.begin() as connection:
            yield connection

    def rows(self, query: Select[Any]) -> Sequence[RowMapping]:
        """Return all rows of a query."""
        with self.read() as connection:
            return connection.execute(query).mappings().all()

    def row(self, query: Select[Any]) -> RowMapping | None:
        """Return the only row of a query; None if it has none."""
        with self.read() as connection:
            return connection.execute(query).mappings().one_or_none()

    def announced_write(self) -> AbstractContextManager[None]:
        """Return a context in which to prepare work for `write_together`.

        Other threads that write together wait a moment for it, so that one commit does for all.
        """
        return self._group.announced()

    def write_together(self, work: Work) -> None:
        """Run some work in one transaction with the writes of other threads.

        The work is on disk when this returns. If the work raises an error, it alone is undone and
        the error is raised here. The work may be run twice, the first time undone.
        """
        self._group.run(work)

    def now_s(self, connection: Connection) -> float:
        """Return the database's own time in s, which is one clock for all of its users."""
        if self.is_sqlite:
            query = "SELECT (julianday('now') - 2440587.5) * 86400.0"
        else:
            query = "SELECT extract(epoch FROM clock_timestamp())"
        return float(connection.execute(text(query)).scalar_one())

    def prepare(self) -> None:
        """Create an SQLite file if it is missing, and enable its write-ahead log.

        With that log, readers and writers do not wait for each other.
        """
        if not self.is_sqlite:
            return
        self._create_privately()
        deadline_s = time.monotonic() + BUSY_S
        while (problem := self._use_write_ahead_log()) is not None:
            # SQLite does not wait by itself for the lock that this change needs.
            if not isinstance(problem, RepositoryBusyError) or time.monotonic() > deadline_s:
                raise problem
            time.sleep(0.01)

    def _create_privately(self) -> None:
        """Create an SQLite file that only its user may read; its logs inherit the permissions."""
        file = self._engine.url.database or ""
        if not file.startswith("file:"):  # a URI of SQLite's own may hold more than a path
            with suppress(OSError):  # SQLite's own error is clearer
                os.close(os.open(file, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600))

    def _use_write_ahead_log(self) -> RepositoryError | None:
        try:
            with closing(self._engine.raw_connection()) as raw:
                raw.cursor().execute("PRAGMA journal_mode = WAL")
        except sqlite3.Error as error:
            return _named(error, self.name)
        except DBAPIError as error:
            return _named(error.orig, self.name)
        return None

    @contextmanager
    def savepoint(self, connection: Connection) -> Iterator[None]:
        """Open a part of a transaction, which alone is undone when an error leaves the context."""
        with connection.begin_nested(), self._named_errors():
            yield

    @contextmanager
    def _named_errors(self) -> Iterator[None]:
        try:
            yield
        except DBAPIError as error:
            raise _named(error.orig, self.name) from error
        except SQLAlchemyError as error:
            raise RepositoryError(f"{self.name}: {error}") from error


def _sqlite(url: URL) -> Engine:
    engine = create_engine(url, connect_args={"timeout": BUSY_S})

    @event.listens_for(engine, "connect")
    def configure(connection: Any, _: object) -> None:
        connection.isolation_level = None  # transactions begin below, not where the driver guesses
        connection.execute("PRAGMA foreign_keys = ON")
        # A committed record must survive a power cut: a lost intent is a motion without any record.
        connection.execute("PRAGMA synchronous = FULL")

    @event.listens_for(engine, "begin")
    def begin(connection: Connection) -> None:
        writes = connection.get_execution_options().get(_WRITES, False)
        # The lock is taken at once, since a read that later writes may be out of date by then.
        connection.exec_driver_sql("BEGIN IMMEDIATE" if writes else "BEGIN")

    return engine


def _postgresql(url: URL) -> Engine:
    if find_spec("psycopg") is None:
        raise RepositoryUrlError(
            "a repository on PostgreSQL needs psycopg: pip install 'nufleet[repository]'"
        )
    limits = f"-c lock_timeout={int(BUSY_S * 1000)}"
    return create_engine(
        url,
        pool_pre_ping=True,
        connect_args={"connect_timeout": int(BUSY_S), "options": limits},
    )


def _named(cause: BaseException | None, database: str) -> RepositoryError:
    """Return the repository error for a driver's error, with advice on what to do."""
    if isinstance(cause, sqlite3.Error):
        code = getattr(cause, "sqlite_errorname", "")
        kind = _first(_SQLITE_CLASSES, code) or RepositoryError
    else:
        code = getattr(cause, "sqlstate", None) or ""
        kind = _first(_POSTGRESQL_CLASSES, code) or RepositoryError
        if not code:  # no server ever answered
            kind = RepositoryUnreachableError
    advice = _ADVICE.get(kind)
    sentence = " ".join(str(cause).split())
    return kind(f"repository {database}: {sentence}" + (f"; {advice}" if advice else ""))


def _first(classes: _Classes, code: str) -> type[RepositoryError] | None:
    return next((kind for prefix, kind in classes if code.startswith(prefix)), None)
