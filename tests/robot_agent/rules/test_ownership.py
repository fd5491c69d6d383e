"""Who commands a robot: every question there is between three orchestrators and a few epochs."""

from __future__ import annotations

import itertools

from nufleet.robot_agent.rules.ownership import (
    WAITS_S,
    Commander,
    Waiting,
    refusal_to_begin,
    refusal_to_command,
    takes_over,
    waiting_next,
)
from nufleet.shared.wire.messages import EPOCH_JUMP_MAX, EPOCH_MAX, Refusal

OWNERS = ("a", "b", "c")
EPOCHS = (0, 1, 2, 3)
HELD: tuple[Commander | None, ...] = (
    None,
    *(Commander(owner, epoch) for owner in OWNERS for epoch in EPOCHS if epoch > 0),
)
SENDERS = tuple(Commander(owner, epoch) for owner in OWNERS for epoch in EPOCHS)
QUESTIONS = tuple(itertools.product(HELD, SENDERS, (True, False), (None, *OWNERS)))


def answer(held: Commander | None, sender: Commander, alive: bool, moving: str | None) -> str:
    refusal = refusal_to_command(held, sender, held_alive=alive, moving_for=moving)
    if refusal is None:
        return "yes"
    if refusal.code == "stale-epoch":
        assert held is not None
        assert refusal.reason.startswith(f"{held.owner} commands it under epoch {held.epoch}; ")
    else:
        assert moving is not None
        assert refusal.reason.startswith(f"it is moving for {moving}, which is alive")
    return refusal.code


def test_all_questions_are_looked_at() -> None:
    assert len(QUESTIONS) == 10 * 12 * 2 * 4


def test_the_epoch_never_falls() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if answer(held, sender, alive, moving) == "yes" and takes_over(held, sender):
            assert sender.epoch > 0
            assert held is None or sender.epoch >= held.epoch


def test_an_epoch_that_is_over_is_refused_for_ever_and_to_everyone() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if held is not None and 0 < sender.epoch < held.epoch:
            assert answer(held, sender, alive, moving) == "stale-epoch"


def test_the_same_epoch_from_somebody_else_is_refused_while_its_owner_lives() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if held is None or sender.epoch != held.epoch or sender.owner == held.owner:
            continue
        if alive:
            assert answer(held, sender, alive, moving) == "stale-epoch"
        else:
            assert answer(held, sender, alive, moving) in ("yes", "busy")


def test_a_higher_epoch_takes_over_a_robot_that_moves_for_nobody_else() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if sender.epoch > (0 if held is None else held.epoch):
            expected = "yes" if moving in (None, sender.owner) else "busy"
            assert answer(held, sender, alive, moving) == expected


def test_nobody_takes_over_a_robot_that_moves_for_somebody_alive() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if answer(held, sender, alive, moving) == "yes" and takes_over(held, sender):
            assert moving in (None, sender.owner)


def test_the_owner_itself_is_obeyed_under_its_epoch_whatever_happens() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if held == sender:
            assert answer(held, sender, alive, moving) == "yes"
            assert not takes_over(held, sender)


def test_who_has_no_lease_gives_way_to_who_has_one_and_takes_nothing_over() -> None:
    for held, sender, alive, moving in QUESTIONS:
        if sender.epoch == 0:
            follows = held is not None and alive and held.owner != sender.owner
            assert answer(held, sender, alive, moving) == ("stale-epoch" if follows else "yes")
            assert not takes_over(held, sender)


def test_an_epoch_that_jumps_is_refused_and_one_that_rises_is_not() -> None:
    held, jump = Commander("a", 5), 5 + EPOCH_JUMP_MAX
    assert answer(held, Commander("b", jump), False, None) == "yes"
    refusal = refusal_to_command(held, Commander("b", jump + 1), held_alive=False, moving_for=None)
    assert refusal is not None
    assert refusal.code == "epoch-jump"
    assert refusal.reason.startswith(
        f"b sent epoch {jump + 1}, and this robot accepts none above {jump};"
    )
    assert "--forget-owner" in refusal.reason


def test_a_robot_that_knows_no_owner_takes_any_epoch_that_leaves_room_in_a_number() -> None:
    assert answer(None, Commander("a", EPOCH_MAX), False, None) == "yes"
    for epoch in (EPOCH_MAX + 1, 2**63 - 1):
        refusal = refusal_to_command(None, Commander("a", epoch), held_alive=False, moving_for=None)
        assert refusal is not None
        assert refusal.code == "epoch-jump"
    last = Commander("a", EPOCH_MAX)
    for epoch, expected in ((EPOCH_MAX, "yes"), (EPOCH_MAX + 1, "epoch-jump")):
        found = refusal_to_command(last, Commander("a", epoch), held_alive=True, moving_for=None)
        assert ("yes" if found is None else found.code) == expected


def waits_after(
    waiting: Commander | None,
    sender: Commander,
    code: str = "busy",
    *,
    held: Commander | None = None,
    alive: tuple[str, ...] = OWNERS,
    passed_s: float = 0.0,
) -> Commander | None:
    """Who waits once a sender was answered, `passed_s` after the one that waited had asked."""
    before = None if waiting is None else Waiting(waiting, 100.0)
    refusal = None if code == "yes" else Refusal(code=code, reason="because")
    now_s = 100.0 + passed_s
    found = waiting_next(before, sender, refusal, held=held, alive=alive, now_s=now_s)
    if found is None:
        return None
    assert found == before or found == Waiting(sender, now_s)
    return found.commander


def test_of_those_that_wait_the_one_under_the_highest_epoch_is_next() -> None:
    for sender in SENDERS:
        assert waits_after(None, sender) == sender
        for waiting in SENDERS:
            highest = waiting if waiting.epoch > sender.epoch else sender
            assert waits_after(waiting, sender) == highest


def test_only_who_is_alive_and_may_take_over_at_rest_waits() -> None:
    for sender in SENDERS:
        for code in ("yes", "stale-epoch", "epoch-jump"):
            assert waits_after(None, sender, code) is None
        gone = tuple(owner for owner in OWNERS if owner != sender.owner)
        assert waits_after(None, sender, alive=gone) is None


def test_who_waits_does_so_until_it_is_gone_or_stops_asking_or_its_epoch_is_over() -> None:
    waiting, other = Commander("a", 2), Commander("b", 1)
    for code in ("yes", "busy", "stale-epoch"):
        kept = waits_after(waiting, other, code, held=other, passed_s=WAITS_S)
        assert kept == waiting
        instead = other if code == "busy" else None
        assert waits_after(waiting, other, code, alive=("b", "c")) == instead
        assert waits_after(waiting, other, code, passed_s=WAITS_S + 0.01) == instead
        for epoch in (2, 3):
            assert waits_after(waiting, other, code, held=Commander("c", epoch)) == instead


def test_who_asks_again_waits_for_longer() -> None:
    sender = Commander("a", 2)
    again = waiting_next(
        Waiting(sender, 100.0),
        sender,
        Refusal(code="busy", reason="it moves"),
        held=None,
        alive=OWNERS,
        now_s=104.0,
    )
    assert again == Waiting(sender, 104.0)


def test_a_robot_begins_nothing_below_the_epoch_that_waits_for_it() -> None:
    for waiting, sender in itertools.product(SENDERS, SENDERS):
        refusal = refusal_to_begin(Waiting(waiting, 0.0), sender)
        assert (refusal is not None) == (sender.epoch < waiting.epoch)
        assert refusal_to_begin(None, sender) is None
