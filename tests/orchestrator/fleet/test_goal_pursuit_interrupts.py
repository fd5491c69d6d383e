"""A goal that is to end: nothing is sent afterwards, and its robot confirms that it rests."""

from __future__ import annotations

import pytest
from pursued_goal import (
    EARLIER,
    GOAL,
    PursuedGoal,
    accepted,
    fetched,
    lost,
    refused,
    running,
    state,
)

from nufleet.orchestrator.fleet.goal_events import (
    CancelTaken,
    Ended,
    Fetched,
    InterruptAsked,
    Question,
    TokenBack,
    TokenLost,
)
from nufleet.orchestrator.fleet.goal_pursuit import (
    PASSING,
    REFUSAL_PATIENCE_S,
    REST_PATIENCE_S,
    RETURN_PATIENCE_S,
)
from nufleet.shared.wire.messages import Outcome

SEND, FETCH, CANCEL = Question.GOAL, Question.RESULT, Question.CANCEL


def test_an_interrupt_before_the_goal_was_sent_ends_it_at_once() -> None:
    goal = PursuedGoal(alive=False)
    assert goal.happens(InterruptAsked()) == []
    assert goal.ended == Ended(interrupted=True)


def test_an_interrupt_while_the_goal_is_on_its_way_is_confirmed_before_it_is_over() -> None:
    goal = PursuedGoal()
    assert goal.happens(InterruptAsked()) == [CANCEL]
    # The cancel came first: the robot will refuse the goal.
    assert goal.happens(CancelTaken()) == [FETCH]
    goal.happens(refused(SEND, "cancelled"))
    assert goal.ended is None
    goal.happens(refused(FETCH, "result-gone"))
    assert goal.ended == Ended(interrupted=True)


def test_an_interrupt_that_crosses_the_acceptance_ends_with_the_result() -> None:
    goal = PursuedGoal()
    goal.happens(InterruptAsked())
    goal.happens(accepted())
    goal.happens(CancelTaken())
    result = fetched(Outcome.CANCELLED)
    goal.happens(result)
    assert goal.ended == Ended(result=result.result)


def test_nothing_is_sent_after_an_interrupt_though_the_agent_died_and_returns() -> None:
    goal = PursuedGoal()
    goal.happens(TokenLost(), lost(SEND))
    goal.passes(1.0)
    goal.happens(InterruptAsked())
    for _ in range(10):
        goal.happens(lost(CANCEL))
        assert goal.passes(0.1) == [CANCEL]
    assert goal.happens(TokenBack()) == []
    goal.happens(CancelTaken(), refused(FETCH, "result-gone"))
    assert goal.ended == Ended(interrupted=True)
    assert [ask.question for ask in goal.asked].count(SEND) == 1


@pytest.mark.parametrize("code", [*sorted(PASSING), "busy", "cancelled", "goal-id-reused"])
def test_no_refusal_of_the_goal_hides_that_it_may_come_again_after_an_interrupt(code: str) -> None:
    goal = PursuedGoal()
    goal.happens(InterruptAsked(), refused(SEND, code))
    assert goal.passes(1.0) == []
    assert (goal.ended, set(goal.open)) == (None, {CANCEL})


def test_a_robot_that_is_silent_when_it_is_interrupted_is_asked_to_cancel() -> None:
    goal = running()
    goal.passes(3.0)
    goal.happens(lost(FETCH), state())
    assert goal.happens(InterruptAsked()) == [CANCEL]
    assert goal.ended is None


def test_a_cancel_is_asked_until_it_is_confirmed() -> None:
    goal = running()
    goal.happens(InterruptAsked())
    for _ in range(3):
        goal.happens(lost(CANCEL))
        assert goal.passes(0.1) == [CANCEL]
        goal.happens(refused(CANCEL, "overloaded"), state())
        assert goal.passes(0.1) == [CANCEL]
    assert goal.happens(CancelTaken()) == [FETCH]
    for _ in range(3):
        goal.happens(refused(FETCH, "not-finished"))
        assert goal.passes(0.6) == [FETCH]
    goal.happens(fetched(Outcome.CANCELLED))
    assert goal.ended is not None
    assert goal.ended.result is not None


@pytest.mark.parametrize("code", ["journal", "internal-error", "overloaded"])
def test_a_cancel_that_is_refused_for_long_is_not_confirmed(code: str) -> None:
    goal = running()
    goal.happens(InterruptAsked())
    for _ in range(100):
        assert goal.ended is None
        goal.happens(refused(CANCEL, code))
        goal.beats(0.5, state())
        if goal.now_s > 1000.0 + REFUSAL_PATIENCE_S:
            break
    goal.happens(refused(CANCEL, code))
    assert goal.ended is not None
    assert (goal.ended.interrupted, goal.ended.abandoned) == (True, (GOAL,))
    assert code in goal.error


def test_an_interrupt_while_the_result_is_fetched_keeps_the_result() -> None:
    goal = running()
    goal.happens(state(None, last_goal_id=GOAL))
    assert goal.happens(InterruptAsked()) == [CANCEL]
    answer: Fetched = fetched()
    goal.happens(answer)
    assert goal.ended == Ended(result=answer.result)


def test_an_interrupt_while_an_abandoned_goal_is_cancelled_sends_nothing_and_waits_for_it() -> None:
    goal = PursuedGoal(abandoned=(EARLIER,))
    assert goal.happens(InterruptAsked()) == []
    assert goal.ended is None
    goal.happens(CancelTaken())
    assert goal.ended == Ended(interrupted=True)


def test_one_whose_agent_is_gone_for_good_is_abandoned_by_an_interrupt() -> None:
    goal = running()
    goal.happens(InterruptAsked(), TokenLost())
    while goal.ended is None and goal.now_s < 1100.0:
        goal.happens(lost(CANCEL))
        goal.passes(0.05)
    assert goal.now_s <= 1000.1 + RETURN_PATIENCE_S
    assert goal.ended is not None
    assert (goal.ended.interrupted, goal.ended.abandoned) == (True, (GOAL,))


def test_one_that_does_not_come_to_rest_is_given_up_and_named() -> None:
    goal = running()
    goal.happens(InterruptAsked(), CancelTaken())
    while goal.ended is None and goal.now_s < 1200.0:
        goal.happens(refused(FETCH, "not-finished"))
        goal.beats(0.5, state())
    assert 1000.0 + REST_PATIENCE_S <= goal.now_s <= 1001.0 + REST_PATIENCE_S
    assert f"was told to end {GOAL} but is not at rest" in goal.error
    assert goal.ended is not None
    assert (goal.ended.interrupted, goal.ended.abandoned) == (True, (GOAL,))
