"""One goal, one motion: a pure state machine over goal ids.

A goal id with the same content is the same goal however often it arrives; with other content it is
refused. One goal runs at a time. What has ended stays known by its id, so that a late duplicate
starts nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from nufleet.shared.wire.messages import Outcome, Refusal

REMEMBERED_GOALS = 10_000
"""How many ended goals are remembered; the oldest are forgotten first."""


@dataclass(frozen=True)
class Goal:
    """A goal that was accepted; `outcome` is None while it runs."""

    goal_id: str
    owner: str
    digest: str
    outcome: Outcome | None = None


@dataclass(frozen=True)
class Goals:
    """All goals known, by id in order of arrival, and the one that runs."""

    known: Mapping[str, Goal] = field(default_factory=lambda: MappingProxyType({}))
    running: str | None = None


@dataclass(frozen=True)
class Accepted:
    """The goal is taken; `new` says that its motion is to begin now."""

    goal: Goal
    new: bool


def submit(
    goals: Goals, *, goal_id: str, owner: str, digest: str
) -> tuple[Goals, Accepted | Refusal]:
    """Take a goal, recognise one already taken, or refuse.

    Args:
        goals: the state.
        goal_id: the id its sender made.
        owner: who sends it.
        digest: a hash of what is to be done; two goals are the same when id and digest are.
    """
    known = recognise(goals, goal_id=goal_id, digest=digest)
    if known is not None:
        return goals, known
    if goals.running is not None:
        running = goals.known[goals.running]
        return goals, Refusal(
            code="busy", reason=f"running goal {running.goal_id} of {running.owner}"
        )
    goal = Goal(goal_id, owner, digest)
    return Goals(_remember(goals.known, goal), running=goal_id), Accepted(goal, new=True)


def recognise(goals: Goals, *, goal_id: str, digest: str) -> Accepted | Refusal | None:
    """Return what is to be said of a goal id that is known already; None for a new one."""
    known = goals.known.get(goal_id)
    if known is None:
        return None
    if _is_forgone(known):
        return Refusal(code="cancelled", reason=f"goal {goal_id} was cancelled before it came")
    if known.digest != digest:
        return Refusal(
            code="goal-id-reused", reason=f"goal {goal_id} is known with another content"
        )
    return Accepted(known, new=False)


def cancel(goals: Goals, goal_id: str) -> Refusal | None:
    """Return why a goal cannot be cancelled; None when it is to end, or never to begin."""
    known = goals.known.get(goal_id)
    if known is None or known.outcome is None or _is_forgone(known):
        return None
    return Refusal(code="goal-ended", reason=f"goal {goal_id} has ended already: {known.outcome}")


def end(goals: Goals, goal_id: str, outcome: Outcome) -> Goals:
    """Record how the running goal ended; the robot is at rest and free again."""
    if goals.running != goal_id:
        raise ValueError(f"goal {goal_id} does not run; {goals.running} does")
    ended = replace(goals.known[goal_id], outcome=outcome)
    return Goals(_remember(goals.known, ended), running=None)


def forgo(goals: Goals, goal_id: str, owner: str) -> Goals:
    """Remember a goal that was cancelled before it came, so that it moves nothing when it does."""
    # Nobody knows its content.
    forgone = Goal(goal_id, owner, "", Outcome.CANCELLED)
    return replace(goals, known=_remember(goals.known, forgone))


def take_back(goals: Goals, goal_id: str) -> Goals:
    """Forget the running goal, which neither moved nor was answered: it could not be stored."""
    if goals.running != goal_id:
        raise ValueError(f"goal {goal_id} does not run; {goals.running} does")
    others = {known: goal for known, goal in goals.known.items() if known != goal_id}
    return Goals(MappingProxyType(others), running=None)


def _is_forgone(goal: Goal) -> bool:
    return goal.outcome is Outcome.CANCELLED and not goal.digest


def _remember(known: Mapping[str, Goal], goal: Goal) -> Mapping[str, Goal]:
    kept = {**known, goal.goal_id: goal}
    # Not the one that runs, though many may be cancelled meanwhile that never came.
    ended = [goal_id for goal_id, one in kept.items() if one.outcome is not None]
    for oldest in ended[: max(0, len(kept) - REMEMBERED_GOALS)]:
        del kept[oldest]
    return MappingProxyType(kept)
