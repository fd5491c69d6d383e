"""What happened in one simulation, and the invariants that it is held to."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


class Violation(AssertionError):
    """An invariant does not hold; the message says which, when and for whom."""


@dataclass
class Motion:
    """One motion of one robot; `ended_s` is None while it lasts."""

    robot: str
    goal_id: str
    owner: str
    began_s: float
    resting_s: float | None = None
    ended_s: float | None = None
    completed: bool = False


@dataclass
class History:
    """Facts as they happen, each compared at once with what was promised before."""

    motions: list[Motion] = field(default_factory=list)
    moved: Counter[tuple[str, str]] = field(default_factory=Counter)
    silent_after: dict[tuple[str, str], float] = field(default_factory=dict)
    stopped_since: dict[str, float] = field(default_factory=dict)
    story: list[str] = field(default_factory=list)
    told: bool = False

    def tell(self, now_s: float, what: str) -> None:
        """Keep a line of the story, if anybody is to read it."""
        if self.told:
            self.story.append(f"{now_s:8.3f} {what}")

    def began(self, now_s: float, robot: str, goal_id: str, owner: str) -> Motion:
        """A robot begins to move.

        Raises:
            Violation: it moved for this goal before, is stopped, or was to move no more for this
                owner, whose interrupt had returned.
        """
        self.tell(now_s, f"{robot} begins {goal_id} for {owner}")
        self.moved[robot, goal_id] += 1
        if self.moved[robot, goal_id] > 1:
            raise Violation(f"{now_s:.3f}: {robot} moves a second time for {goal_id}")
        if robot in self.stopped_since:
            raise Violation(
                f"{now_s:.3f}: {robot} begins {goal_id}, and was stopped at "
                f"{self.stopped_since[robot]:.3f}"
            )
        silent_s = self.silent_after.get((robot, owner))
        if silent_s is not None and now_s > silent_s:
            raise Violation(
                f"{now_s:.3f}: {robot} begins {goal_id} for {owner}, whose interrupt had returned "
                f"at {silent_s:.3f}"
            )
        motion = Motion(robot, goal_id, owner, now_s)
        self.motions.append(motion)
        return motion

    def interrupt_returned(self, robot: str, owner: str, at_s: float) -> None:
        """From then on a robot must not begin to move for that owner."""
        self.silent_after[robot, owner] = at_s

    def stop_confirmed(self, now_s: float, robot: str) -> None:
        """A robot said that it is stopped: it must not begin to move until it is released."""
        self.tell(now_s, f"{robot} confirms its stop")
        self.stopped_since[robot] = now_s

    def release_asked(self, now_s: float, robot: str) -> None:
        """Somebody asks a robot to be released; it may move any time after."""
        self.tell(now_s, f"{robot} is asked to be released")
        self.stopped_since.pop(robot, None)
