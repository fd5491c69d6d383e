"""Leases: one owner at a time, with an epoch that only rises; races of real processes."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace

import lease_racer
import pytest
from counted_statements import counted_statements
from polling import PATIENCE_S, wait_until
from repository_records import FLEET

from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import (
    EpochOutOfRangeError,
    LeaseHeldError,
    LeaseLostError,
)
from nufleet.orchestrator.repository.lease_rules import EPOCH_BELIEVED_MAX, StoredLease, acquired
from nufleet.orchestrator.repository.records import LastLease, Lease
from nufleet.orchestrator.repository.repository import Repository
from nufleet.shared.wire.messages import EPOCH_MAX

LONG_S = 60.0
RACERS = 3
ROUNDS = 20


class Clock:
    """The clock of a database, which moves only when it is set."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._now_s = 1.75e9
        monkeypatch.setattr(Database, "now_s", lambda *_: self._now_s)

    def set_by(self, seconds: float) -> None:
        self._now_s += seconds


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    return Clock(monkeypatch)


def test_a_free_robot_is_taken_with_a_new_epoch(repository: Repository) -> None:
    leases = repository.leases.acquire(FLEET, ["r2", "r1"], owner="a", term_s=LONG_S)
    assert leases == (Lease(FLEET, "r1", "a", 1, LONG_S), Lease(FLEET, "r2", "a", 1, LONG_S))
    held = repository.leases.held(FLEET)
    assert {robot: held[robot][:2] for robot in held} == {"r1": ("a", 1), "r2": ("a", 1)}


def test_the_leases_of_a_whole_fleet_are_renewed_in_one_statement(repository: Repository) -> None:
    robots = [f"r{number}" for number in range(50)]
    leases = repository.leases.acquire(FLEET, robots, owner="a", term_s=LONG_S)
    with counted_statements(repository) as statements:
        repository.leases.renew(leases)
    assert [said for said in statements if said.startswith("UPDATE")] == ["UPDATE leases"]
    assert not [said for said in statements if said.startswith("SAVEPOINT")]


def test_a_robot_of_another_is_refused_with_who_it_is_and_nothing_else_is_taken(
    repository: Repository,
) -> None:
    repository.leases.acquire(FLEET, ["r2"], owner="a", term_s=LONG_S)
    with pytest.raises(LeaseHeldError, match="owned by a") as refused:
        repository.leases.acquire(FLEET, ["r1", "r2", "r3"], owner="b", term_s=LONG_S)
    assert (refused.value.robot, refused.value.owner, refused.value.epoch) == ("r2", "a", 1)
    assert 0.0 < refused.value.remaining_s <= LONG_S
    assert set(repository.leases.held(FLEET)) == {"r2"}


def test_who_holds_a_robot_already_gets_the_same_epoch(repository: Repository) -> None:
    first = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S)
    assert repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S) == first


def test_the_epoch_rises_with_every_owner_after_a_release(repository: Repository) -> None:
    epochs = []
    for owner in ("a", "b", "a"):
        leases = repository.leases.acquire(FLEET, ["r1"], owner=owner, term_s=LONG_S)
        epochs.append(leases[0].epoch)
        repository.leases.release(leases)
        assert not repository.leases.held(FLEET)
    assert epochs == [1, 2, 3]


def test_the_epoch_is_above_what_the_robot_has_seen_elsewhere(repository: Repository) -> None:
    seen = {"r1": 41}
    for _ in range(2):
        leases = repository.leases.acquire(
            FLEET, ["r1", "r2"], owner="a", term_s=LONG_S, above_epochs=seen
        )
        assert [lease.epoch for lease in leases] == [42, 1]
        # The robot has seen this one by now; that is no reason for another.
        seen = {"r1": 42}
    (lease, _) = repository.leases.acquire(
        FLEET, ["r1", "r2"], owner="a", term_s=LONG_S, above_epochs={"r1": 50}
    )
    assert lease.epoch == 51


@pytest.mark.parametrize("epoch", [EPOCH_BELIEVED_MAX + 1, 2**63 - 1, 2**64])
def test_an_epoch_that_no_repository_gives_out_is_an_error_that_says_what_to_do(
    repository: Repository, epoch: int
) -> None:
    with pytest.raises(EpochOutOfRangeError, match=f"r1 .* epoch {epoch}, .* r1 --forget-owner"):
        repository.leases.acquire(
            FLEET, ["r1", "r2"], owner="a", term_s=LONG_S, above_epochs={"r1": epoch}
        )
    # Once the robot has forgotten it, nothing is left of it here either.
    leases = repository.leases.acquire(FLEET, ["r1", "r2"], owner="a", term_s=LONG_S)
    assert [lease.epoch for lease in leases] == [1, 1]


def test_the_highest_epoch_that_is_believed_leaves_room_above_it(repository: Repository) -> None:
    (lease,) = repository.leases.acquire(
        FLEET, ["r1"], owner="a", term_s=LONG_S, above_epochs={"r1": EPOCH_BELIEVED_MAX}
    )
    assert lease.epoch == EPOCH_BELIEVED_MAX + 1 < EPOCH_MAX
    repository.leases.release([lease])


def test_a_repository_whose_epochs_are_used_up_says_so() -> None:
    stored = StoredLease(FLEET, "r1", "a", EPOCH_MAX, 8.0, 0.0)
    with pytest.raises(EpochOutOfRangeError, match="start a new repository with --repository"):
        acquired(stored, owner="b", term_s=8.0, above_epoch=0, now_s=1.0)


def test_fleets_do_not_meet(repository: Repository) -> None:
    repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S)
    repository.leases.acquire("other", ["r1"], owner="b", term_s=LONG_S)
    assert repository.leases.held("other")["r1"][0] == "b"


def expired(repository: Repository) -> bool:
    return not repository.leases.held(FLEET)


def test_a_silent_owner_is_replaced_under_a_higher_epoch(repository: Repository) -> None:
    repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S)
    with pytest.raises(LeaseHeldError):
        repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=LONG_S)
    old = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=0.05)
    wait_until(lambda: expired(repository))
    (new,) = repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=LONG_S)
    assert new.epoch == 2
    with pytest.raises(LeaseLostError, match="b owns it under epoch 2"):
        repository.leases.renew(old)
    repository.leases.release(old)
    assert repository.leases.held(FLEET)["r1"][:2] == ("b", 2)


def test_a_lease_that_ran_out_and_that_nobody_took_is_renewed(repository: Repository) -> None:
    leases = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=0.2)
    wait_until(lambda: expired(repository))
    assert repository.leases.last(FLEET)["r1"] == LastLease("a", 1, silent=True)
    repository.leases.renew(leases)
    assert repository.leases.last(FLEET)["r1"] == LastLease("a", 1, silent=False)


def test_a_lease_that_was_released_cannot_be_renewed(repository: Repository) -> None:
    leases = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S)
    repository.leases.release(leases)
    assert repository.leases.last(FLEET)["r1"] == LastLease("a", 1, silent=False)
    with pytest.raises(LeaseLostError, match="it was released"):
        repository.leases.renew(leases)


JUMPS_S = (-1.0, -2.5, -3.0, -3600.0, 7.0, 3600.0)


@pytest.mark.parametrize("jump_s", JUMPS_S)
def test_an_owner_keeps_its_lease_whatever_the_clock_is_set_to(
    repository: Repository, clock: Clock, jump_s: float
) -> None:
    leases = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=8.0)
    for _ in range(2):
        clock.set_by(jump_s)
        repository.leases.renew(leases)
        owner, epoch, remaining_s = repository.leases.held(FLEET)["r1"]
        assert (owner, epoch) == ("a", 1)
        assert remaining_s == pytest.approx(8.0)
        with pytest.raises(LeaseHeldError):
            repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=8.0)


@pytest.mark.parametrize("jump_s", [jump_s for jump_s in JUMPS_S if jump_s < 0])
def test_a_clock_that_was_set_back_frees_nobodys_robot(
    repository: Repository, clock: Clock, jump_s: float
) -> None:
    repository.leases.acquire(FLEET, ["r1", "r2"], owner="a", term_s=8.0)
    clock.set_by(jump_s)
    with pytest.raises(LeaseHeldError) as refused:
        repository.leases.acquire(FLEET, ["r1", "r2"], owner="b", term_s=8.0)
    assert refused.value.remaining_s == 8.0
    renewals = refused.value.renewals
    assert [renewal.robot for renewal in renewals] == ["r1", "r2"]
    assert all(renewal.before_set_back for renewal in renewals)
    # Who watched these for a whole term and saw no other knows that their owner is silent.
    with pytest.raises(LeaseHeldError, match="robot r2 is owned by a"):
        repository.leases.acquire(FLEET, ["r1", "r2"], owner="b", term_s=8.0, silent=renewals[:1])
    taken = repository.leases.acquire(FLEET, ["r1", "r2"], owner="b", term_s=8.0, silent=renewals)
    assert [lease.epoch for lease in taken] == [2, 2]


def test_what_was_renewed_is_not_taken_from_an_owner_that_was_thought_silent(
    repository: Repository, clock: Clock
) -> None:
    leases = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=8.0)
    clock.set_by(-60.0)
    with pytest.raises(LeaseHeldError) as refused:
        repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=8.0)
    repository.leases.renew(leases)
    with pytest.raises(LeaseHeldError, match="owned by a"):
        repository.leases.acquire(
            FLEET, ["r1"], owner="b", term_s=8.0, silent=refused.value.renewals
        )


def test_who_was_replaced_after_the_clock_was_set_forward_is_told_and_the_epoch_rose(
    repository: Repository, clock: Clock
) -> None:
    old = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=8.0)
    clock.set_by(3600.0)
    (new,) = repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=8.0)
    assert new.epoch == 2
    with pytest.raises(LeaseLostError, match="b owns it under epoch 2"):
        repository.leases.renew(old)


def test_an_owner_who_returns_after_its_lease_ran_out_gets_a_new_epoch(
    repository: Repository,
) -> None:
    repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=0.05)
    wait_until(lambda: expired(repository))
    (again,) = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S)
    assert again.epoch == 2


def test_a_renewed_lease_begins_its_term_again(repository: Repository) -> None:
    leases = repository.leases.acquire(FLEET, ["r1"], owner="a", term_s=LONG_S)

    def left_s() -> float:
        return repository.leases.held(FLEET)["r1"][2]

    wait_until(lambda: left_s() < LONG_S - 0.2)
    before_s = left_s()

    def renewed() -> bool:
        repository.leases.renew(leases)
        return left_s() > before_s

    wait_until(renewed)
    with pytest.raises(LeaseHeldError):
        repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=LONG_S)


def test_of_several_leases_all_are_renewed_or_none(repository: Repository) -> None:
    kept, lost = repository.leases.acquire(FLEET, ["r1", "r2"], owner="a", term_s=LONG_S)
    with pytest.raises(LeaseLostError):
        repository.leases.renew([kept, replace(lost, epoch=9)])
    repository.leases.renew([kept, lost])


def test_processes_that_race_open_one_database_and_have_one_winner(address: str) -> None:
    context = multiprocessing.get_context("spawn")
    start = context.Barrier(RACERS)
    pipes = [context.Pipe(duplex=False) for _ in range(RACERS)]
    racers = [
        context.Process(
            target=lease_racer.race, args=(address, n, ROUNDS, start, pipes[n][1]), daemon=True
        )
        for n in range(RACERS)
    ]
    for racer in racers:
        racer.start()
    won: list[tuple[int, list[int]]] = []
    for (receiver, sender), racer in zip(pipes, racers, strict=True):
        assert receiver.poll(PATIENCE_S)
        won += receiver.recv()
        racer.join(PATIENCE_S)
        assert racer.exitcode == 0
        racer.close()
        receiver.close()
        sender.close()
    # Every round has one winner, who has every robot, under an epoch of its own.
    assert sorted(won) == [(n, [n + 1] * 3) for n in range(ROUNDS)]
