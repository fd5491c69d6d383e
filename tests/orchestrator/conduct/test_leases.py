"""Leases that an orchestrator holds while it works: renewed, lost, released, waited for."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest
from polling import PATIENCE_S, wait_until

from nufleet.orchestrator.conduct import leases as held_leases
from nufleet.orchestrator.conduct.leases import HeldLeases, hold_leases
from nufleet.orchestrator.fleet.goal_runner import Interrupted
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import (
    LeaseHeldError,
    LeaseLostError,
    RepositoryUnreachableError,
)
from nufleet.orchestrator.repository.records import Lease
from nufleet.orchestrator.repository.repository import Repository, open_repository

ROBOTS = ("r1", "r2")


@pytest.fixture
def repository(tmp_path: Path) -> Iterator[Repository]:
    with open_repository(f"{tmp_path}/nufleet.sqlite") as opened:
        yield opened


@pytest.fixture
def set_clock(monkeypatch: pytest.MonkeyPatch) -> Callable[[float], None]:
    """Sets the repository's clock forward by a number of seconds."""
    right, off_s = Database.now_s, [0.0]

    def set_by(seconds: float) -> None:
        off_s[0] += seconds

    monkeypatch.setattr(Database, "now_s", lambda *asked: right(*asked) + off_s[0])
    return set_by


TERM_S = 120.0
"""Longer than any process has to wait for its turn on a busy machine."""


@pytest.fixture
def quick(monkeypatch: pytest.MonkeyPatch) -> None:
    """Renewals that can be waited for."""
    monkeypatch.setattr(held_leases, "TERM_S", TERM_S)
    monkeypatch.setattr(held_leases, "RENEW_EVERY_S", 0.1)


def hold(repository: Repository, owner: str, **options: object) -> HeldLeases:
    return hold_leases(repository.leases, "lab", ROBOTS, owner=owner, **options)  # type: ignore[arg-type]


def test_robots_are_held_as_long_as_their_owner_lives_and_free_afterwards(
    repository: Repository,
    quick: None,
    set_clock: Callable[[float], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    renewals, renew = 0, repository.leases.renew

    def counted(leases: Iterable[Lease]) -> None:
        nonlocal renewals
        renew(leases)
        renewals += 1

    monkeypatch.setattr(repository.leases, "renew", counted)
    with hold(repository, "a") as leases:
        assert leases.epochs == {"r1": 1, "r2": 1}
        for _ in range(4):
            set_clock(TERM_S / 2)
            begun = renewals + 1  # one may be under way
            wait_until(lambda: renewals > begun)  # noqa: B023
            assert {owner for owner, _, _ in repository.leases.held("lab").values()} == {"a"}
    assert not repository.leases.held("lab")
    with hold(repository, "b") as leases:
        assert leases.epochs == {"r1": 2, "r2": 2}


def test_another_orchestrator_is_told_who_holds_a_robot_and_for_how_long(
    repository: Repository,
) -> None:
    with hold(repository, "a"), pytest.raises(LeaseHeldError, match=r"owned by a .*another \d"):
        hold(repository, "b")


def test_waiting_for_an_owner_that_lives_ends_with_who_it_is(
    repository: Repository, quick: None
) -> None:
    told: list[LeaseHeldError] = []
    with hold(repository, "a"), pytest.raises(LeaseHeldError, match="owned by a"):
        hold(repository, "b", patient=True, on_wait=told.append)
    assert [held.owner for held in told] == ["a"]


def test_the_robots_of_an_owner_that_died_are_had_once_its_lease_has_run_out(
    repository: Repository, set_clock: Callable[[float], None]
) -> None:
    hold(repository, "a")  # never entered, hence never renewed
    told: list[str] = []

    def has_run_out(held: LeaseHeldError) -> None:
        told.append(held.owner)
        set_clock(held_leases.TERM_S)

    with hold(repository, "b", patient=True, on_wait=has_run_out) as leases:
        assert leases.epochs == {"r1": 2, "r2": 2}
    assert told == ["a"]


def test_a_clock_that_is_set_takes_no_robot_from_a_living_owner(
    repository: Repository,
    quick: None,
    set_clock: Callable[[float], None],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    renewed, interrupted, renew = threading.Semaphore(0), threading.Event(), repository.leases.renew

    def counted(leases: object) -> None:
        renew(leases)  # type: ignore[arg-type]
        renewed.release()

    monkeypatch.setattr(repository.leases, "renew", counted)
    with hold(repository, "a") as leases, leases.guarding(interrupted.set):
        for jump_s in (-1.0, -3.0, -3600.0, 3600.0, -2.5):
            assert renewed.acquire(timeout=PATIENCE_S)
            set_clock(jump_s)
            if jump_s < 0.0:
                # Who wants it waits, although it is not patient, to see whether it is renewed.
                with pytest.raises(LeaseHeldError, match="owned by a"):
                    hold(repository, "b")
            for _ in range(2):
                assert renewed.acquire(timeout=PATIENCE_S)
            assert {owner for owner, _, _ in repository.leases.held("lab").values()} == {"a"}
        assert not interrupted.is_set()


@pytest.mark.parametrize("patient", [True, False])
def test_the_robots_of_a_dead_owner_are_had_within_a_term_after_the_clock_was_set_back(
    repository: Repository,
    set_clock: Callable[[float], None],
    monkeypatch: pytest.MonkeyPatch,
    patient: bool,
) -> None:
    monkeypatch.setattr(held_leases, "TERM_S", 1.0)
    hold(repository, "a")  # never entered, hence never renewed
    set_clock(-3600.0)
    told: list[LeaseHeldError] = []
    asked_s = time.monotonic()
    with hold(repository, "b", patient=patient, on_wait=told.append) as leases:
        assert leases.epochs == {"r1": 2, "r2": 2}
        assert time.monotonic() - asked_s >= 1.0
    assert [held.owner for held in told] == ["a"]


def taken_over(repository: Repository) -> bool:
    """Let another have the robots, as after a pause in which nothing was renewed."""
    try:
        repository.leases.acquire("lab", ROBOTS, owner="b", term_s=60.0)
    except LeaseHeldError:
        return False
    return True


def test_who_lost_its_robots_is_interrupted_and_told_why(
    repository: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held_leases, "TERM_S", 0.3)
    monkeypatch.setattr(held_leases, "RENEW_EVERY_S", 0.8)
    interrupted = threading.Event()

    def work(leases: HeldLeases) -> None:
        with leases.guarding(interrupted.set):
            wait_until(lambda: taken_over(repository))
            assert interrupted.wait(PATIENCE_S)
            raise Interrupted

    with hold(repository, "a") as leases:
        with pytest.raises(LeaseLostError, match="a no longer owns robot r1 under epoch 1"):
            work(leases)
        # What begins only now is interrupted at once.
        late = threading.Event()
        with leases.guarding(late.set):
            assert late.is_set()
    assert {owner for owner, _, _ in repository.leases.held("lab").values()} == {"b"}


def test_an_interruption_by_somebody_else_stays_one(repository: Repository) -> None:
    with (
        hold(repository, "a") as leases,
        pytest.raises(Interrupted),
        leases.guarding(lambda: None),
    ):
        raise Interrupted


def test_a_database_that_is_away_for_less_than_a_term_loses_nothing(
    repository: Repository, quick: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    interrupted, calls = threading.Event(), 0
    renew = repository.leases.renew

    def away_for_a_while(leases: object) -> None:
        nonlocal calls
        calls += 1
        if 2 <= calls <= 4:
            raise RepositoryUnreachableError("the server is restarting")
        renew(leases)  # type: ignore[arg-type]

    monkeypatch.setattr(repository.leases, "renew", away_for_a_while)
    with hold(repository, "a") as leases, leases.guarding(interrupted.set):
        wait_until(lambda: calls > 6)
        assert not interrupted.is_set()


def test_a_database_that_stays_away_ends_the_work(
    repository: Repository, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held_leases, "TERM_S", 0.3)
    monkeypatch.setattr(held_leases, "RENEW_EVERY_S", 0.1)

    def away(leases: object) -> None:
        raise RepositoryUnreachableError("the server is gone")

    monkeypatch.setattr(repository.leases, "renew", away)
    interrupted = threading.Event()

    def work(leases: HeldLeases) -> None:
        with leases.guarding(interrupted.set):
            assert interrupted.wait(PATIENCE_S)
            raise Interrupted

    with hold(repository, "a") as leases, pytest.raises(LeaseLostError, match="server is gone"):
        work(leases)
