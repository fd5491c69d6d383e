"""One goal, one motion: a pure state machine over goal ids.

A goal id that arrives again with the same content is the same goal; with other content it is
refused. One goal runs at a time. Goals that have ended stay known by their ids, so that a late
duplicate starts nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType

from nufleet.shared.wire.messages import Outcome, Refusal

REMEMBERED_GOALS = 10_000
"""Largest number of goals kept by id; the oldest that have ended are dropped first."""


@dataclass(frozen=True)
class Goal:
    """A goal that was accepted, or cancelled before it arrived."""

    goal_id: str
    """Id that its sender chose."""

    owner: str
    """Name of the orchestrator that sent it."""

    digest: str
    """Hash of the motion requested; empty for a goal cancelled before it arrived."""

    outcome: Outcome | None = None
    """How the goal ended; None while it runs."""


@dataclass(frozen=True)
class Goals:
    """The state of the machine."""

    known: Mapping[str, Goal] = field(default_factory=lambda: MappingProxyType({}))
    """All goals known, by id, in order of arrival."""

    running: str | None = None
    """Id of the goal that runs; None when none does."""


@dataclass(frozen=True)
class Accepted:
    """The answer to a goal that is taken, or was taken before."""

    goal: Goal
    """The goal as it is known."""

    new: bool
    """True when the goal's motion is to begin now."""


def submit(
    goals: Goals, *, goal_id: str, owner: str, digest: str
) -> tuple[Goals, Accepted | Refusal]:
    """Accept a goal, recognise one already accepted, or refuse.

    Args:
        goals: Current state.
        goal_id: Id that the sender chose.
        owner: Name of the orchestrator that sends the goal.
        digest: Hash of the motion requested; two goals are the same when id and digest are.

    Returns:
        The next state, and the answer to the sender.
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
    """Return the answer to a goal whose id is already known; None for a new id."""
    known = goals.known.get(goal_id)
    if known is None:
        return None
    if _is_forgone(known):
        return Refusal(code="cancelled", reason=f"goal {goal_id} was cancelled before it arrived")
    if known.digest != digest:
        return Refusal(
            code="goal-id-reused", reason=f"goal {goal_id} is known with different content"
        )
    return Accepted(known, new=False)


def cancel(goals: Goals, goal_id: str) -> Refusal | None:
    """Return why a goal cannot be cancelled.

    None means that it can: the running goal is to end, and an unknown one never to begin.
    """
    known = goals.known.get(goal_id)
    if known is None or known.outcome is None or _is_forgone(known):
        return None
    return Refusal(code="goal-ended", reason=f"goal {goal_id} has already ended: {known.outcome}")


def end(goals: Goals, goal_id: str, outcome: Outcome) -> Goals:
    """Record how the running goal ended; the robot is at rest and free again.

    Raises:
        ValueError: The goal does not run.
    """
    if goals.running != goal_id:
        raise ValueError(f"goal {goal_id} does not run; {goals.running} does")
    ended = replace(goals.known[goal_id], outcome=outcome)
    return Goals(_remember(goals.known, ended), running=None)


def forgo(goals: Goals, goal_id: str, owner: str) -> Goals:
    """Record a goal cancelled before it arrived, so that its late arrival moves nothing."""
    # The content of such a goal is unknown; an empty digest marks it.
    forgone = Goal(goal_id, owner, "", Outcome.CANCELLED)
    return replace(goals, known=_remember(goals.known, forgone))


def take_back(goals: Goals, goal_id: str) -> Goals:
    """Remove the running goal because it could not be stored; it neither moved nor was answered.

    Raises:
        ValueError: The goal does not run.
    """
    if goals.running != goal_id:
        raise ValueError(f"goal {goal_id} does not run; {goals.running} does")
    others = {known: goal for known, goal in goals.known.items() if known != goal_id}
    return Goals(MappingProxyType(others), running=None)


def _is_forgone(goal: Goal) -> bool:
    return goal.outcome is Outcome.CANCELLED and not goal.digest


def _remember(known: Mapping[str, Goal], goal: Goal) -> Mapping[str, Goal]:
    kept = {**known, goal.goal_id: goal}
    # The running goal is never dropped, even if it is the oldest because many goals that never
    # arrived have been cancelled since.
    ended = [goal_id for goal_id, one in kept.items() if one.outcome is not None]
    for oldest in ended[: max(0, len(kept) - REMEMBERED_GOALS)]:
        del kept[oldest]
    return MappingProxyType(kept)
