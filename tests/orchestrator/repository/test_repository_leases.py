"""Leases: one owner at a time, with an epoch that only rises; races of real processes."""

from __future__ import annotations

import multiprocessing
from dataclasses import replace

import lease_racer
import pytest
from polling import PATIENCE_S, wait_until
from repository_records import FLEET

from orchestrator.repository.errors import LeaseHeldError, LeaseLostError
from orchestrator.repository.records import Lease
from orchestrator.repository.repository import Repository

LONG_S = 60.0
RACERS = 3
ROUNDS = 20


def test_a_free_robot_is_taken_with_a_new_epoch(repository: Repository) -> None:
    leases = repository.leases.acquire(FLEET, ["r2", "r1"], owner="a", term_s=LONG_S)
    assert leases == (Lease(FLEET, "r1", "a", 1, LONG_S), Lease(FLEET, "r2", "a", 1, LONG_S))
    held = repository.leases.held(FLEET)
    assert {robot: held[robot][:2] for robot in held} == {"r1": ("a", 1), "r2": ("a", 1)}


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
    with pytest.raises(LeaseLostError, match="not renewed"):
        repository.leases.renew(old)
    (new,) = repository.leases.acquire(FLEET, ["r1"], owner="b", term_s=LONG_S)
    assert new.epoch == 2
    with pytest.raises(LeaseLostError, match="b owns it under epoch 2"):
        repository.leases.renew(old)
    repository.leases.release(old)
    assert repository.leases.held(FLEET)["r1"][:2] == ("b", 2)


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
