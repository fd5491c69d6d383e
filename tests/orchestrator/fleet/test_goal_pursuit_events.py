"""The promises that every sequence of events of a goal must keep."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from hypothesis import given, settings
from hypothesis import strategies as st
from pursued_goal import (
    BEGAN_S,
    EARLIER,
    GOAL,
    PursuedGoal,
    accepted,
    fetched,
    lost,
    refused,
    state,
)

from nufleet.orchestrator.fleet.goal_events import (
    Accepted,
    CancelTaken,
    Event,
    Fetched,
    Heard,
    InterruptAsked,
    Passed,
    Question,
    Refused,
    TokenBack,
    TokenLost,
    Unanswered,
)
from nufleet.orchestrator.fleet.goal_pursuit import (
    ANSWER_PATIENCE_S,
    ANSWER_TRIES,
    NEVER_BEGINS,
    PASSING,
    REFUSAL_PATIENCE_S,
    REST_PATIENCE_S,
    RETURN_PATIENCE_S,
)

GRACE_S = 30.0
"""How long a motion may get no further; see `Overdue`."""

CODES = {
    Question.GOAL: ("amplitude", "busy", "cancelled", *sorted(PASSING)),
    Question.RESULT: ("not-finished", "not-finished", "unknown-goal", "result-gone", "overloaded"),
    Question.CANCEL: ("goal-ended", "stale-epoch", "journal", "overloaded"),
}
SIGNS: tuple[Event, ...] = (
    state(),
    state(progress=0.3),
    state(progress=0.7),
    state(None),
    state(None, last_goal_id=GOAL),
    state(EARLIER),
    state(None, boot_id="boot-2"),
    TokenLost(),
    TokenBack(),
    InterruptAsked(),
    Passed(),
)


@dataclass
class Answer:
    """An answer to one of the open questions, as the numbers choose, or to none of them."""

    question: int
    kind: int
    stray: bool


@dataclass
class Bystander:
    """Hears what is said, and knows from the promises alone what may follow."""

    heard_s: float = BEGAN_S
    progress: float = 0.0
    progress_s: float = math.inf
    unanswered_s: list[float] = field(default_factory=list)
    cancel_refused_s: float | None = None
    cancelled_s: float | None = None
    interrupted: bool = False
    result_known: bool = False

    def hears(self, event: Event, goal: PursuedGoal, answered: Question | None) -> None:
        """Take in what happens; `answered` is the open question that it answers."""
        now_s = goal.now_s
        match event:
            case Heard(heard):
                self.heard_s = now_s
                if heard.goal_id == GOAL and heard.progress > self.progress:
                    self.progress, self.progress_s = heard.progress, now_s
            case TokenBack() | TokenLost():
                self.heard_s = now_s
            case InterruptAsked():
                self.interrupted = True
            case Unanswered() if answered:
                self.unanswered_s.append(now_s)
            case Passed() | Unanswered():
                pass
            case _ if answered:
                self.heard_s, self.unanswered_s = now_s, []
                self._hears_answer(event, goal.open[answered], now_s)

    def _hears_answer(self, answer: Event, goal_id: str, now_s: float) -> None:
        match answer:
            case Accepted():
                self.progress_s = min(self.progress_s, now_s)
            case Fetched():
                self.result_known = True
            case Refused(Question.CANCEL, error) if error.code not in NEVER_BEGINS:
                self.cancel_refused_s = self.cancel_refused_s or now_s
            case CancelTaken() | Refused(Question.CANCEL):
                self.cancel_refused_s = None
                if goal_id == GOAL:
                    self.cancelled_s = self.cancelled_s or now_s

    def judges(self, goal: PursuedGoal, *, sent: bool) -> None:
        """Look at how it ended."""
        ended, now_s = goal.ended, goal.ended_s
        assert ended is not None
        assert now_s is not None
        if self.interrupted and sent and not self.result_known and self.cancelled_s is None:
            assert GOAL in ended.abandoned, "it may move its robot still, and nobody is told"
        if ended.error is None:
            assert self.interrupted or ended.result is not None
            return
        lost_s = self.unanswered_s
        assert (
            isinstance(goal.ended_by, Fetched | Refused)  # the robot's own word
            or now_s - self.heard_s >= RETURN_PATIENCE_S
            or (len(lost_s) >= ANSWER_TRIES and lost_s[-1] - lost_s[0] >= ANSWER_PATIENCE_S)
            or (self.cancelled_s is not None and now_s - self.cancelled_s >= REST_PATIENCE_S)
        )
        if isinstance(goal.ended_by, Fetched):
            assert now_s - self.progress_s >= GRACE_S, "only what was overdue"
        if isinstance(goal.ended_by, Refused) and goal.ended_by.question is Question.CANCEL:
            assert self.cancel_refused_s is not None
            assert now_s - self.cancel_refused_s >= REFUSAL_PATIENCE_S


def answers(question: Question) -> tuple[Event, ...]:
    yes: Event = {
        Question.GOAL: accepted(),
        Question.RESULT: fetched(),
        Question.CANCEL: CancelTaken(),
    }[question]
    return (yes, yes, lost(question), *(refused(question, code) for code in CODES[question]))


def chosen(goal: PursuedGoal, answer: Answer) -> tuple[Event, Question | None] | None:
    """Return an answer and the open question that it answers; None when there is none."""
    questions = sorted(set(Question) - set(goal.open) if answer.stray else goal.open)
    if not questions:
        return None
    question = questions[answer.question % len(questions)]
    possible = answers(question)
    return possible[answer.kind % len(possible)], None if answer.stray else question


# Times that are sums of powers of two, so that none is late by a rounding error.
STEPS = st.lists(
    st.tuples(
        st.sampled_from([0.0, 1 / 64, 1 / 8, 0.5, 0.5, 2.0, 4.0, 9.0, 30.0]),
        st.sampled_from(SIGNS)
        | st.builds(Answer, st.integers(0, 2), st.integers(0, 9), st.just(False))
        | st.builds(Answer, st.integers(0, 2), st.integers(0, 9), st.booleans()),
    ),
    max_size=60,
)


@settings(max_examples=400)
@given(
    steps=STEPS,
    alive=st.booleans(),
    taken_before=st.booleans(),
    abandoned=st.sampled_from([(), (EARLIER,)]),
)
def test_every_sequence_of_events_keeps_every_promise(
    steps: list[tuple[float, Event | Answer]],
    alive: bool,
    taken_before: bool,
    abandoned: tuple[str, ...],
) -> None:
    # `PursuedGoal` looks itself that nothing is asked twice at a time or after the end, that the
    # end stays, and that it is never woken for nothing.
    goal = PursuedGoal(alive=alive, taken_before=taken_before, abandoned=abandoned)
    bystander = Bystander(progress_s=BEGAN_S if taken_before else math.inf)
    for time_s, step in steps:
        meanwhile = goal.passes(time_s)
        assert not bystander.interrupted or Question.GOAL not in meanwhile
        what = chosen(goal, step) if isinstance(step, Answer) else (step, None)
        if what is not None:
            if goal.ended is None:
                bystander.hears(what[0], goal, what[1])
            at_that = goal.happens(what[0])
            assert not bystander.interrupted or Question.GOAL not in at_that
    # Nothing is heard any more: it ends, and soon.
    goal.passes(RETURN_PATIENCE_S)
    assert goal.ended is not None
    assert goal.pursuit.wake_s == math.inf
    sent = taken_before or any(ask.question is Question.GOAL for ask in goal.asked)
    bystander.judges(goal, sent=sent)
