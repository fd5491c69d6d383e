"""Who commands a robot: every question there is between three orchestrators and a few epochs."""

from __future__ import annotations

import itertools

from robot_agent.ownership import Commander, refusal_to_command, takes_over

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
        assert refusal.reason.startswith(f"it moves for {moving}, who is alive")
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
