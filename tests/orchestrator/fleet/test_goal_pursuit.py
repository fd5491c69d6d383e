"""A goal on its way: what is asked of its robot, when it is over, and who is given up."""

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
    Ask,
    CancelTaken,
    Ended,
    InterruptAsked,
    Passed,
    Question,
    TokenBack,
    TokenLost,
)
from nufleet.orchestrator.fleet.goal_pursuit import (
    ANSWER_PATIENCE_S,
    ANSWER_TRIES,
    PASSING,
    REFUSAL_PATIENCE_S,
    REFUSALS_PATIENCE_S,
    REST_PATIENCE_S,
    RETURN_PATIENCE_S,
)
from nufleet.shared.errors import NoReplyError, RefusedError, RobotLostError
from nufleet.shared.wire.messages import Outcome

SEND, FETCH, CANCEL = Question.GOAL, Question.RESULT, Question.CANCEL


# As it should be.


def test_a_goal_is_sent_once_waited_for_and_fetched() -> None:
    goal = PursuedGoal()
    assert goal.asked == [Ask(SEND, GOAL)]
    assert goal.happens(accepted()) == []
    assert goal.beats(27.0, state()) == []
    assert goal.happens(state(None, last_goal_id=GOAL)) == [FETCH]
    result = fetched()
    goal.happens(result)
    assert goal.ended == Ended(result=result.result)


def test_one_that_was_taken_before_is_not_sent_again() -> None:
    goal = PursuedGoal(taken_before=True)
    assert goal.asked == [Ask(FETCH, GOAL)]
    goal.happens(refused(FETCH, "not-finished"))
    assert SEND not in goal.beats(10.0, state())
    goal.happens(state(None, last_goal_id=GOAL))
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_a_robot_that_is_not_there_is_waited_for_and_asked_when_it_comes() -> None:
    goal = PursuedGoal(alive=False)
    assert goal.asked == []
    assert goal.passes(RETURN_PATIENCE_S - 0.1) == []
    assert goal.happens(TokenBack()) == [SEND]


def test_one_that_does_not_come_is_an_error_that_asks_for_its_agent() -> None:
    goal = PursuedGoal(alive=False)
    goal.passes(RETURN_PATIENCE_S)
    assert isinstance(goal.ended, Ended)
    assert isinstance(goal.ended.error, RobotLostError)
    assert "robot r1 is gone" in goal.error
    assert "is its agent running?" in goal.error
    assert goal.ended.abandoned == ()


# Questions that are lost.


def test_a_question_that_is_lost_is_asked_again() -> None:
    goal = PursuedGoal()
    for _ in range(5):
        goal.happens(lost(SEND))
        assert goal.passes(0.1) == [SEND]
        goal.happens(state(None))
    goal.happens(accepted(), state(), state(None, last_goal_id=GOAL))
    for _ in range(5):
        assert FETCH in goal.open
        goal.happens(lost(FETCH))
        goal.passes(0.1)
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_answers_that_come_twice_or_unasked_change_nothing() -> None:
    goal = PursuedGoal()
    goal.happens(accepted(wall_duration_s=1e5), state())
    for _ in range(ANSWER_TRIES):
        assert goal.happens(accepted(), CancelTaken(), fetched(), lost(SEND), lost(FETCH)) == []
        assert goal.happens(refused(FETCH, "unknown-goal"), refused(SEND, "stopped")) == []
        assert goal.beats(ANSWER_PATIENCE_S, state()) == []
    assert goal.ended is None
    goal.happens(state(None, last_goal_id=GOAL), fetched())
    ended = goal.ended
    assert ended is not None
    assert ended.result is not None
    assert goal.happens(InterruptAsked(), fetched(Outcome.FAILED), TokenLost(), Passed()) == []
    assert goal.ended is ended
    assert goal.passes(1000.0) == []


def test_a_robot_that_is_heard_and_never_answers_is_given_up_in_the_end() -> None:
    goal = PursuedGoal()
    for _ in range(round(ANSWER_PATIENCE_S / 3.0)):
        goal.beats(3.0, state(None))
        goal.happens(lost(SEND))
        assert goal.ended is None
    goal.beats(3.0, state(None))
    goal.happens(lost(SEND))
    assert goal.ended is not None
    assert isinstance(goal.ended.error, NoReplyError)
    assert goal.ended.abandoned == (GOAL,)


def test_one_question_that_takes_long_to_be_lost_gives_nobody_up() -> None:
    goal = PursuedGoal()
    goal.happens(lost(SEND))
    for _ in range(ANSWER_TRIES - 2):
        goal.beats(ANSWER_PATIENCE_S + 1.0, state(None))
        goal.happens(lost(SEND))
    assert goal.ended is None
    goal.passes(0.1)
    goal.happens(accepted())
    assert goal.pursuit.accepted is not None


# Refusals.


def refused_for(goal: PursuedGoal, code: str, seconds: float) -> list[Question]:
    """Refuse the goal every second until it is given up; return what is asked at the last time."""
    asked = goal.happens(refused(SEND, code))
    for _ in range(round(seconds)):
        if asked:
            break
        goal.passes(1.0)
        asked = goal.happens(refused(SEND, code))
    return asked


@pytest.mark.parametrize("code", sorted(PASSING))
def test_a_refusal_that_says_nothing_about_the_goal_passes_or_is_final_in_the_end(
    code: str,
) -> None:
    goal = PursuedGoal()
    assert refused_for(goal, code, REFUSAL_PATIENCE_S - 1) == []
    assert goal.ended is None
    taken = PursuedGoal()
    taken.happens(refused(SEND, code))
    taken.passes(0.1)
    taken.happens(accepted())
    assert taken.ended is None
    goal.passes(1.0)
    assert goal.happens(refused(SEND, code)) == [CANCEL]
    goal.happens(refused(CANCEL, code))
    assert goal.ended is not None
    assert isinstance(goal.ended.error, RefusedError)
    assert goal.ended.error.code == code
    assert goal.ended.abandoned == (GOAL,)


def test_refusals_before_the_orchestrator_was_frozen_say_nothing_of_the_robot_afterwards() -> None:
    goal = PursuedGoal()
    goal.happens(refused(SEND, "not-ready"))
    assert goal.passes(0.1) == [SEND]
    goal.freezes(13.5)
    assert goal.happens(refused(SEND, "not-ready")) == []
    goal.passes(0.1)
    assert goal.happens(accepted()) == []
    assert goal.pursuit.accepted is not None


def test_a_cause_that_passes_leaves_the_next_one_its_time_but_not_for_ever() -> None:
    goal = PursuedGoal()
    codes = ("not-ready", "frozen") * 4
    asked_s = 0.0
    for code in codes:
        asked_s += 0.9 * REFUSAL_PATIENCE_S
        if refused_for(goal, code, 0.9 * REFUSAL_PATIENCE_S) == [CANCEL]:
            break
        goal.passes(0.1)
        assert asked_s < REFUSALS_PATIENCE_S
    assert goal.asked[-1] == Ask(CANCEL, GOAL)
    assert asked_s >= REFUSALS_PATIENCE_S


def test_a_robot_that_was_frozen_once_more_has_its_time_again_to_hear_of_its_owner() -> None:
    goal = PursuedGoal()
    goal.happens(refused(SEND, "frozen"))
    goal.passes(0.1)
    goal.happens(lost(SEND))
    goal.beats(REFUSAL_PATIENCE_S, state(None))
    goal.happens(refused(SEND, "frozen"))
    assert goal.ended is None
    goal.passes(0.1)
    assert goal.happens(accepted()) == []
    assert goal.pursuit.accepted is not None


def test_any_other_refusal_is_final_and_the_goal_cancelled_since_a_copy_may_still_arrive() -> None:
    goal = PursuedGoal()
    assert goal.happens(refused(SEND, "stopped")) == [CANCEL]
    assert goal.happens(CancelTaken()) == [FETCH]
    goal.happens(refused(FETCH, "result-gone"))
    assert goal.ended is not None
    assert isinstance(goal.ended.error, RefusedError)
    assert goal.ended.error.code == "stopped"
    assert goal.ended.abandoned == ()


def test_a_refused_goal_that_a_late_copy_began_is_fetched() -> None:
    goal = PursuedGoal()
    goal.happens(refused(SEND, "stopped"))
    goal.happens(CancelTaken())
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_a_robot_that_is_busy_with_what_was_abandoned_is_brought_to_rest_first() -> None:
    goal = PursuedGoal(abandoned=(EARLIER, "study.0.r1.2"))
    assert goal.asked == [Ask(CANCEL, EARLIER)]
    goal.happens(lost(CANCEL))
    assert goal.passes(0.1) == [CANCEL]
    goal.happens(CancelTaken())
    assert goal.asked[-1] == Ask(CANCEL, "study.0.r1.2")
    assert goal.happens(refused(CANCEL, "goal-ended")) == [SEND]
    # It lands, which takes longer than a refusal may last otherwise.
    while goal.now_s < 1000.0 + REST_PATIENCE_S / 2:
        goal.happens(refused(SEND, "busy"))
        assert goal.beats(0.5, state(EARLIER)) == [SEND]
    goal.happens(accepted(), state(), state(None, last_goal_id=GOAL))
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_the_end_of_somebody_elses_motion_is_waited_for_but_not_for_ever() -> None:
    goal = PursuedGoal()
    while goal.asked[-1] == Ask(SEND, GOAL) and goal.now_s < 1000.0 + 2 * REST_PATIENCE_S:
        goal.passes(0.1)
        goal.happens(refused(SEND, "busy"))
    assert REST_PATIENCE_S <= goal.now_s - 1000.0 <= REST_PATIENCE_S + 0.2
    assert goal.asked[-1] == Ask(CANCEL, GOAL)


# Silence.


def test_a_state_from_before_the_goal_was_taken_ends_nothing() -> None:
    goal = PursuedGoal()
    goal.happens(accepted())
    assert goal.happens(state(None, last_goal_id=EARLIER)) == [FETCH]
    assert goal.happens(refused(FETCH, "not-finished")) == []
    assert goal.beats(27.0, state()) == []
    assert goal.happens(state(None, last_goal_id=GOAL)) == [FETCH]
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_no_state_for_a_while_after_acceptance_is_asked_about_and_no_end() -> None:
    goal = PursuedGoal()
    goal.happens(accepted())
    assert goal.passes(2.6) == [FETCH]
    goal.happens(refused(FETCH, "not-finished"))
    assert goal.beats(24.0, state()) == []
    goal.happens(state(None, last_goal_id=GOAL))
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_a_robot_that_is_silent_in_the_middle_and_heard_again_is_waited_for() -> None:
    goal = running()
    goal.beats(5.0, state())
    assert goal.passes(3.0) == [FETCH]
    goal.happens(lost(FETCH))
    goal.happens(state())
    assert goal.passes(0.1) == [FETCH]
    goal.happens(refused(FETCH, "not-finished"))
    assert goal.beats(2 * RETURN_PATIENCE_S, state()) == []
    assert goal.ended is None
    goal.happens(state(None, last_goal_id=GOAL))
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_one_whose_states_never_arrive_is_heard_by_its_answers() -> None:
    goal = PursuedGoal()
    goal.happens(accepted())
    while goal.now_s < 1000.0 + 60.0:
        assert goal.passes(3.0) == [FETCH]
        goal.happens(refused(FETCH, "not-finished"))
    goal.passes(3.0)
    goal.happens(fetched())
    assert goal.ended is not None
    assert goal.ended.result is not None


def test_one_that_is_silent_for_too_long_is_given_up_with_what_may_move_it_still() -> None:
    goal = running()
    goal.passes(RETURN_PATIENCE_S - 0.01)
    assert goal.ended is None
    goal.passes(0.02)
    assert goal.ended is not None
    assert isinstance(goal.ended.error, RobotLostError)
    assert f"robot r1 went silent during {GOAL}" in goal.error
    assert goal.ended.abandoned == (GOAL,)


def test_what_was_abandoned_and_not_cancelled_stays_abandoned() -> None:
    goal = PursuedGoal(abandoned=(EARLIER,))
    goal.passes(RETURN_PATIENCE_S)
    assert goal.ended is not None
    assert goal.ended.abandoned == (EARLIER,)


def test_a_token_that_is_lost_and_back_is_asked_about_and_no_end() -> None:
    goal = running()
    assert goal.happens(TokenLost()) == []
    assert goal.passes(RETURN_PATIENCE_S - 0.1) == []
    assert goal.happens(TokenBack()) == [FETCH]
    goal.happens(refused(FETCH, "not-finished"))
    assert goal.beats(RETURN_PATIENCE_S, state()) == []
    assert goal.ended is None


def test_one_that_disappears_and_does_not_return_is_given_up() -> None:
    goal = running()
    goal.happens(TokenLost())
    goal.passes(RETURN_PATIENCE_S)
    assert f"robot r1 disappeared during {GOAL}, and it did not return" in goal.error


def test_another_agent_process_says_how_the_goal_was_lost() -> None:
    goal = running()
    goal.happens(TokenLost(), TokenBack())
    goal.happens(state(None, boot_id="boot-2"), fetched(Outcome.LOST))
    assert goal.ended is not None
    assert goal.ended.result is not None
    assert goal.ended.result.outcome is Outcome.LOST


def test_one_that_remembers_nothing_is_lost_and_not_given_up() -> None:
    goal = running()
    goal.happens(TokenLost(), TokenBack(), refused(FETCH, "unknown-goal"))
    assert goal.ended is not None
    assert isinstance(goal.ended.error, RobotLostError)
    assert "disappeared" in goal.error
    assert goal.ended.abandoned == ()


# Motions that take too long.


def test_a_motion_that_gets_no_further_is_cancelled_before_its_robot_is_given_up() -> None:
    goal = running()
    while not (asked := goal.beats(0.5, state(progress=0.5))):
        assert goal.now_s < 1200.0
    assert asked == [CANCEL]
    assert goal.now_s >= 1000.0 + 1.5 * 27.0 + 30.0
    assert goal.happens(CancelTaken()) == [FETCH]
    goal.happens(fetched(Outcome.CANCELLED))
    assert goal.ended is not None
    assert isinstance(goal.ended.error, RobotLostError)
    assert "is overdue with" in goal.error
    assert "50%" in goal.error
    assert goal.ended.abandoned == ()


def test_one_that_gets_further_is_not_overdue() -> None:
    goal = running()
    for percent in range(0, 100, 10):
        goal.beats(25.0, state(progress=percent / 100))
    assert goal.ended is None
    assert goal.open == {}
