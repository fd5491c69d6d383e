"""The history of one simulation, and the invariants that it must satisfy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field


class Violation(AssertionError):  # noqa: N818 - it names what it is
    """An invariant does not hold; the message names it, the time and the robot."""


@dataclass
class Motion:
    """One motion of one robot, with times on the virtual clock."""

    robot: str
    """Name of the robot."""

    goal_id: str
    """Id of the goal that the motion belongs to."""

    owner: str
    """Name of the orchestrator that sent the goal."""

    began_s: float
    """Time at which the motion began."""

    resting_s: float | None = None
    """Time at which the robot began to come to rest; None before that."""

    ended_s: float | None = None
    """Time at which the robot was at rest; None while the motion lasts."""

    completed: bool = False
    """Whether the motion was played to its end."""


@dataclass
class History:
    """The events of a simulation, each checked against earlier promises as soon as it happens."""

    motions: list[Motion] = field(default_factory=list)
    """All motions, in the order in which they began."""

    moved: Counter[tuple[str, str]] = field(default_factory=Counter)
    """Number of motions by robot and goal id, which may not exceed 1."""

    silent_after: dict[tuple[str, str], float] = field(default_factory=dict)
    """Time by robot and owner after which the robot may not begin to move for that owner."""

    interrupted: dict[str, float] = field(default_factory=dict)
    """Time by owner after which no goal of the interrupted owner may begin any more."""

    stopped_since: dict[str, float] = field(default_factory=dict)
    """Time by robot at which its stop was confirmed; absent for a robot that may move."""

    story: list[str] = field(default_factory=list)
    """Lines of the story, for a person to read."""

    told: bool = False
    """Whether the story is recorded."""

    def tell(self, now_s: float, what: str) -> None:
        """Add a line to the story, if it is recorded."""
        if self.told:
            self.story.append(f"{now_s:8.3f} {what}")

    def began(self, now_s: float, robot: str, goal_id: str, owner: str) -> Motion:
        """Record that a robot begins to move.

        Raises:
            Violation: The robot has moved for this goal before, is stopped, or must not move any
                more for this owner, which was interrupted.
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
        interrupted_s = self.interrupted.get(owner)
        if interrupted_s is not None and now_s > interrupted_s:
            raise Violation(
                f"{now_s:.3f}: {robot} begins {goal_id} for {owner}, which was interrupted, and "
                f"nothing can have been in transit since {interrupted_s:.3f}"
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
        """Record that a robot must not begin to move for an owner after `at_s`."""
        self.silent_after[robot, owner] = at_s

    def stop_confirmed(self, now_s: float, robot: str) -> None:
        """Record that a robot confirmed a stop; it must not begin to move until a release."""
        self.tell(now_s, f"{robot} confirms its stop")
        self.stopped_since[robot] = now_s

    def release_asked(self, now_s: float, robot: str) -> None:
        """Record a request to release a robot, which may move at any time after it."""
        self.tell(now_s, f"{robot} is asked to be released")
        self.stopped_since.pop(robot, None)
