"""One goal, one motion: over every sequence of requests, and with more goals than are kept."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field, replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.robot_agent.rules import goal_machine
from nufleet.robot_agent.rules.goal_machine import (
    Accepted,
    Goals,
    cancel,
    end,
    forgo,
    recognise,
    submit,
)
from nufleet.shared.wire.messages import Outcome, Refusal


@dataclass(frozen=True)
class Submit:
    goal_id: str
    digest: str
    owner: str = "o"


@dataclass(frozen=True)
class Cancel:
    goal_id: str


@dataclass(frozen=True)
class End:
    outcome: Outcome


Step = Submit | Cancel | End
IDS, DIGESTS = ("a", "b"), ("1", "2")
STEPS: tuple[Step, ...] = (
    *(Submit(goal_id, digest) for goal_id in IDS for digest in DIGESTS),
    *(Cancel(goal_id) for goal_id in IDS),
    End(Outcome.COMPLETED),
)


@dataclass(frozen=True)
class Run:
    """A machine and what its answers amounted to, to compare its later answers with."""

    goals: Goals = field(default_factory=Goals)
    motions: tuple[str, ...] = ()
    digests: tuple[tuple[str, str], ...] = ()
    ended: frozenset[str] = frozenset()
    forgone: frozenset[str] = frozenset()


def after(run: Run, step: Step) -> Run:
    """Take one step and check its answer against what happened before."""
    match step:
        case Submit(goal_id, digest, owner):
            return _submitted(run, goal_id, digest, owner)
        case Cancel(goal_id):
            refusal = cancel(run.goals, goal_id)
            if goal_id in run.ended:
                assert refusal is not None
                assert refusal.code == "goal-ended"
                return run
            assert refusal is None
            if goal_id in dict(run.digests):
                return run
            goals = forgo(run.goals, goal_id, "o")
            assert goals.running == run.goals.running
            return replace(run, goals=goals, forgone=run.forgone | {goal_id})
        case End(outcome):
            running = run.goals.running
            if running is None:
                with pytest.raises(ValueError, match="does not run"):
                    end(run.goals, "a", outcome)
                return run
            goals = end(run.goals, running, outcome)
            assert goals.running is None
            assert goals.known[running].outcome is outcome
            return replace(run, goals=goals, ended=run.ended | {running})


def _submitted(run: Run, goal_id: str, digest: str, owner: str) -> Run:
    goals, answer = submit(run.goals, goal_id=goal_id, owner=owner, digest=digest)
    known = dict(run.digests).get(goal_id)
    if known is not None or goal_id in run.forgone:
        assert goals == run.goals  # known before: nothing changes, regardless of the answer
        assert recognise(run.goals, goal_id=goal_id, digest=digest) == answer
    if goal_id in run.forgone:
        assert isinstance(answer, Refusal)
        assert answer.code == "cancelled"
        return run
    if known == digest:
        assert isinstance(answer, Accepted)
        assert not answer.new
        return run
    if known is not None:
        assert isinstance(answer, Refusal)
        assert answer.code == "goal-id-reused"
        return run
    assert recognise(run.goals, goal_id=goal_id, digest=digest) is None
    if run.goals.running is not None:
        assert isinstance(answer, Refusal)
        assert answer.code == "busy"
        assert run.goals.running in answer.reason
        assert goals == run.goals
        return run
    assert isinstance(answer, Accepted)
    assert answer.new
    assert goals.running == goal_id
    return replace(
        run,
        goals=goals,
        motions=(*run.motions, goal_id),
        digests=(*run.digests, (goal_id, digest)),
    )


def runs(depth: int, run: Run) -> Iterator[Run]:
    yield run
    if depth:
        for step in STEPS:
            yield from runs(depth - 1, after(run, step))


def test_every_sequence_of_five_steps_moves_each_goal_at_most_once_and_one_at_a_time() -> None:
    sequences = 0
    for run in runs(5, Run()):
        sequences += 1
        assert len(set(run.motions)) == len(run.motions)
        assert run.forgone.isdisjoint(run.motions)
        unfinished = [goal_id for goal_id in run.motions if goal_id not in run.ended]
        assert unfinished == ([] if run.goals.running is None else [run.goals.running])
    assert sequences == sum(len(STEPS) ** length for length in range(6))


many_steps = st.lists(
    st.builds(
        Submit, st.integers(0, 30).map("g{}".format), st.sampled_from("12"), st.sampled_from("op")
    )
    | st.builds(Cancel, st.integers(0, 30).map("g{}".format))
    | st.builds(End, st.sampled_from(Outcome)),
    max_size=80,
)


@settings(max_examples=60, deadline=None)
@given(steps=many_steps)
def test_long_sequences_keep_the_same_promises(steps: list[Step]) -> None:
    run = Run()
    for step in steps:
        run = after(run, step)
    assert max(Counter(run.motions).values(), default=0) <= 1
    assert run.forgone.isdisjoint(run.motions)


def test_a_request_sent_a_hundred_times_moves_once() -> None:
    goals, motions = Goals(), 0
    for repetition in range(100):
        goals, answer = submit(goals, goal_id="g", owner="o", digest="d")
        assert isinstance(answer, Accepted)
        motions += answer.new
        if repetition == 50:
            goals = end(goals, "g", Outcome.ABORTED)
    assert motions == 1
    assert goals.known["g"].outcome is Outcome.ABORTED


def test_memory_is_bounded_and_the_oldest_goals_are_forgotten_first(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(goal_machine, "REMEMBERED_GOALS", 3)
    goals = Goals()
    for k in range(10):
        goals, answer = submit(goals, goal_id=f"g{k}", owner="o", digest="d")
        assert isinstance(answer, Accepted)
        assert goals.running in goals.known
        assert list(goals.known) == [f"g{j}" for j in range(max(0, k - 2), k + 1)]
        goals = end(goals, f"g{k}", Outcome.COMPLETED)
    # What ended is no younger for having ended later than another began.
    assert list(goals.known) == ["g7", "g8", "g9"]


def test_cancelling_goals_that_never_come_neither_fills_the_memory_nor_ends_the_one_that_runs(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(goal_machine, "REMEMBERED_GOALS", 3)
    goals, _ = submit(Goals(), goal_id="g", owner="o", digest="d")
    for k in range(10):
        goals = forgo(goals, f"f{k}", "o")
        again = recognise(goals, goal_id="g", digest="d")
        assert isinstance(again, Accepted)
        assert cancel(goals, "g") is None
    assert list(goals.known) == ["g", "f8", "f9"]
    assert end(goals, "g", Outcome.COMPLETED).known["g"].outcome is Outcome.COMPLETED
