"""A process that was frozen trusts nothing that waited for it."""

from __future__ import annotations

import pytest

from nufleet.robot_agent.rules.freezes import FROZEN_S, HEARING_S, Freezes


def test_a_process_that_runs_takes_goals_from_its_first_moment() -> None:
    freezes = Freezes(100.0)
    assert freezes.refusal(100.0) is None
    for beat in range(20):
        freezes.beat(100.0 + beat * FROZEN_S)
        assert freezes.refusal(100.0 + beat * FROZEN_S) is None


@pytest.mark.parametrize("first_to_wake", ["beat", "goal"])
def test_a_process_that_was_frozen_takes_no_goal_until_it_has_heard_who_is_there(
    first_to_wake: str,
) -> None:
    freezes = Freezes(100.0)
    woke_s = 100.0 + FROZEN_S + 0.1
    if first_to_wake == "beat":
        freezes.beat(woke_s)
    refusal = freezes.refusal(woke_s)
    assert refusal is not None
    assert refusal.code == "frozen"
    assert "ask again" in refusal.reason
    assert freezes.refusal(woke_s + HEARING_S / 2) is not None
    freezes.beat(woke_s + HEARING_S)
    assert freezes.refusal(woke_s + HEARING_S) is None


def test_a_process_that_freezes_again_while_it_listens_begins_to_listen_anew() -> None:
    freezes = Freezes(0.0)
    freezes.beat(10.0)
    freezes.beat(10.5)
    freezes.beat(20.0)
    assert freezes.refusal(20.0 + 0.9 * HEARING_S) is not None
    assert freezes.refusal(20.0 + HEARING_S) is None
