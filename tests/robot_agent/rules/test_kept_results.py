"""Results: kept until they are acknowledged, and never more than there is room for."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.robot_agent.rules import kept_results as results
from nufleet.robot_agent.rules.kept_results import KEPT_RESULTS, KeptResults
from nufleet.shared.frequency_test.excitation import ExcitationPlan, Tone
from nufleet.shared.wire.messages import GoalResult, Outcome

PLAN = ExcitationPlan(
    axis="x",
    tones=(Tone(omega_rad_s=1.0),),
    amplitude=0.5,
    sample_time_s=0.01,
    ramp_samples=100,
    settle_samples=0,
    segments=3,
    segment_samples=100,
)


def result(goal_id: str, samples: int = 10) -> GoalResult:
    return GoalResult(
        goal_id=goal_id,
        boot_id="b",
        outcome=Outcome.CANCELLED,
        reason="",
        plan=PLAN,
        reference=np.zeros(samples),
        response=np.zeros(samples),
    )


def test_a_result_is_kept_until_it_is_forgotten() -> None:
    kept = KeptResults()
    first, second = result("a"), result("b")
    kept.add(first)
    kept.add(second)
    kept.forget(["a", "never-heard-of", "a"])
    assert kept.get("a") is None
    assert kept.get("b") is second


def test_the_oldest_go_first_when_there_are_too_many() -> None:
    kept = KeptResults()
    for k in range(KEPT_RESULTS + 5):
        kept.add(result(f"g{k}"))
    there = [k for k in range(KEPT_RESULTS + 5) if kept.get(f"g{k}") is not None]
    assert there == list(range(5, KEPT_RESULTS + 5))


def test_large_results_make_room_and_the_newest_always_stays(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(results, "KEPT_RESULT_BYTES", 100 * 16)
    kept = KeptResults()
    for goal_id, samples in (("a", 40), ("b", 40), ("c", 40)):
        kept.add(result(goal_id, samples))
    assert [kept.get(goal_id) is not None for goal_id in "abc"] == [False, True, True]
    kept.add(result("d", 400))
    assert [kept.get(goal_id) is not None for goal_id in "abcd"] == [False, False, False, True]
    kept.forget(["d"])
    for goal_id in "ef":
        kept.add(result(goal_id, 50))
    assert [kept.get(goal_id) is not None for goal_id in "ef"] == [True, True]
