"""Threads that write at the same time: one wait for the disk, and each its own outcome."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager

import pytest
from counted_statements import counted_statements
from polling import PATIENCE_S, wait_until
from repository_records import accepted, intent, measurement
from sqlalchemy import Connection

from nufleet.orchestrator.repository import group_commit
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import (
    RepositoryError,
    RepositoryFullError,
    StaleEpochError,
)
from nufleet.orchestrator.repository.group_commit import GroupCommit, _Job
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.repository.repository import Repository

THREADS = 24


class Gate:
    """Holds the first commit until all threads have brought their work; `batches` are the sizes."""

    def __init__(self, repository: Repository, monkeypatch: pytest.MonkeyPatch) -> None:
        self.batches: list[int] = []
        self.opened = threading.Event()
        self.group: GroupCommit = repository.studies._database._group
        self._commit = self.group._commit
        monkeypatch.setattr(self.group, "_commit", self._held)

    def _held(self, jobs: list[_Job]) -> None:
        self.batches.append(len(jobs))
        assert self.opened.wait(PATIENCE_S)
        self._commit(jobs)


def store_all(begun: Repository, gate: Gate, stale: int | None = None) -> list[Future[None]]:
    """Have threads store acceptances of one trial each; the first waits until all are there."""
    with ThreadPoolExecutor(THREADS) as pool:
        futures = [
            pool.submit(
                begun.studies.accepted,
                accepted(intent(attempt=number)),
                epoch=0 if number == stale else 1,
            )
            for number in range(1, THREADS + 1)
        ]
        # The first thread took its own work, and all that had arrived by then.
        wait_until(lambda: sum(gate.batches) + len(gate.group._jobs) == THREADS)
        gate.opened.set()
    return futures


@pytest.fixture
def intended(begun: Repository) -> Repository:
    begun.studies.intend(*(intent(attempt=number) for number in range(1, THREADS + 1)))
    return begun


def statuses(begun: Repository) -> list[TrialStatus]:
    return [trial.status for trial in begun.studies.trials("run-1")]


def test_what_gathers_during_a_commit_is_the_next_one(
    intended: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate = Gate(intended, monkeypatch)
    with counted_statements(intended) as statements:
        for future in store_all(intended, gate):
            future.result()
    # A beginning and an end of each transaction are not among them, nor is a savepoint.
    work = [said for said in statements if not said.startswith(("BEGIN", "COMMIT"))]
    assert len(work) == THREADS, work
    assert statuses(intended) == [TrialStatus.ACCEPTED] * THREADS
    assert len(gate.batches) == 2
    assert sum(gate.batches) == THREADS


def test_who_may_not_write_is_told_so_and_the_others_are_stored(
    intended: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    futures = store_all(intended, Gate(intended, monkeypatch), stale=7)
    errors = [future.exception() for future in futures]
    assert isinstance(errors.pop(6), StaleEpochError)
    assert errors == [None] * (THREADS - 1)
    found = statuses(intended)
    assert found.pop(6) is TrialStatus.INTENDED
    assert found == [TrialStatus.ACCEPTED] * (THREADS - 1)


def test_a_commit_that_fails_is_everybodys_error_and_nothing_of_it_is_stored(
    intended: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, write = Gate(intended, monkeypatch), Database.write

    @contextmanager
    def full(database: Database) -> Iterator[Connection]:
        with write(database) as connection:
            yield connection
            if len(gate.batches) > 1:
                raise RepositoryFullError("no room is left")

    with monkeypatch.context() as patched:
        patched.setattr(Database, "write", full)
        errors = [future.exception() for future in store_all(intended, gate)]
    failed = [error for error in errors if error is not None]
    assert len(failed) == gate.batches[1]
    assert all(isinstance(error, RepositoryFullError) for error in failed)
    found = statuses(intended)
    assert found == [
        TrialStatus.ACCEPTED if error is None else TrialStatus.INTENDED for error in errors
    ]


def test_a_commit_that_is_interrupted_tells_nobody_that_it_stored_anything(
    intended: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    gate, write = Gate(intended, monkeypatch), Database.write

    @contextmanager
    def interrupted(database: Database) -> Iterator[Connection]:
        with write(database) as connection:
            yield connection
            if len(gate.batches) == 2:
                raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Database, "write", interrupted)
        errors = [future.exception() for future in store_all(intended, gate)]
    told = [error for error in errors if isinstance(error, RepositoryError)]
    assert len(told) == gate.batches[1] - 1
    assert all("interrupted" in str(error) for error in told)
    assert [error for error in errors if isinstance(error, KeyboardInterrupt)]
    assert statuses(intended) == [
        TrialStatus.ACCEPTED if error is None else TrialStatus.INTENDED for error in errors
    ]
    intended.studies.intend(intent(attempt=THREADS + 1))
    assert statuses(intended)[-1] is TrialStatus.INTENDED


def test_a_commit_waits_for_work_that_is_announced(
    intended: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    group = intended.studies._database._group
    batches, asked = [], threading.Event()
    are_enough, commit = group._are_enough, group._commit

    def is_asked() -> bool:
        asked.set()
        return are_enough()

    monkeypatch.setattr(group, "_are_enough", is_asked)
    monkeypatch.setattr(group, "_commit", lambda jobs: (batches.append(len(jobs)), commit(jobs)))
    monkeypatch.setattr(group_commit, "PATIENCE_S", PATIENCE_S)
    first, second = intent(attempt=1), intent(attempt=2)
    with ThreadPoolExecutor(1) as pool:
        with intended.studies.ending():
            other = pool.submit(intended.studies.accepted, accepted(first), epoch=1)
            assert asked.wait(PATIENCE_S)
        intended.studies.ended(second.goal_id, measurement(second), epoch=1)
        other.result(PATIENCE_S)
    assert batches == [2]


def test_a_commit_does_not_wait_for_ever_for_work_that_is_announced(intended: Repository) -> None:
    with ThreadPoolExecutor(1) as pool, intended.studies.ending():
        pool.submit(intended.studies.accepted, accepted(intent()), epoch=1).result(PATIENCE_S)
    assert statuses(intended)[0] is TrialStatus.ACCEPTED


def test_a_writer_after_an_error_is_not_held_up_by_it(intended: Repository) -> None:
    with pytest.raises(StaleEpochError):
        intended.studies.accepted(accepted(intent()), epoch=0)
    intended.studies.ended(intent().goal_id, measurement(intent()), epoch=1)
    assert statuses(intended)[0] is TrialStatus.MEASURED
