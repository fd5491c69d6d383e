"""The history of one simulation, and the invariants that it must satisfy."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from nufleet.orchestrator.fleet.goal_pursuit import REFUSAL_PATIENCE_S


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

    released: dict[str, float] = field(default_factory=dict)
    """Time by robot at which it last accepted a release."""

    stops: dict[tuple[str, str], float] = field(default_factory=dict)
    """Time by robot and sender at which the sender's stop first arrived."""

    killed: dict[str, float] = field(default_factory=dict)
    """Time by robot at which its motors had been cut; absent once it is connected again."""

    unready: dict[str, float] = field(default_factory=dict)
    """Time by robot since which its agent knows that it is not ready; absent if it is ready."""

    accepted: dict[tuple[str, str], float] = field(default_factory=dict)
    """Time by robot and goal id at which the robot accepted the goal."""

    cancelled: set[tuple[str, str]] = field(default_factory=set)
    """Robot and goal id of each goal whose cancellation the robot confirmed."""

    excuses: set[tuple[str, str]] = field(default_factory=set)
    """Robot and code of each refusal for which there has been a cause."""

    story: list[str] = field(default_factory=list)
    """Lines of the story, for a person to read."""

    told: bool = False
    """Whether the story is recorded."""

    def tell(self, now_s: float, what: str) -> None:
        """Add a line to the story, if it is recorded."""
        if self.told:
            self.story.append(f"{now_s:8.3f} {what}")

    def began(self, now_s: float, robot: str, goal_id: str, owner: str) -> Motion:
        """Record that a robot plays the first sample of a motion.

        Raises:
            Violation: The robot has moved for this goal before, or may not move for it.
        """
        self.tell(now_s, f"{robot} begins {goal_id} for {owner}")
        self.moved[robot, goal_id] += 1
        if self.moved[robot, goal_id] > 1:
            raise Violation(f"{now_s:.3f}: {robot} moves a second time for {goal_id}")
        self.may_move(now_s, robot, goal_id, owner)
        motion = Motion(robot, goal_id, owner, now_s)
        self.motions.append(motion)
        return motion

    def may_move(self, now_s: float, robot: str, goal_id: str, owner: str) -> None:
        """Check that a robot may begin to move for a goal, or take off for it.

        Raises:
            Violation: The robot is stopped or not ready, or must not move any more for this goal,
                which was cancelled, or for this owner, which was interrupted.
        """
        if (robot, goal_id) in self.cancelled:
            raise Violation(f"{now_s:.3f}: {robot} begins {goal_id}, which it said is cancelled")
        if robot in self.stopped_since:
            raise Violation(
                f"{now_s:.3f}: {robot} begins {goal_id}, and was stopped at "
                f"{self.stopped_since[robot]:.3f}"
            )
        if robot in self.unready:
            raise Violation(
                f"{now_s:.3f}: {robot} begins {goal_id}, and has not been ready since "
                f"{self.unready[robot]:.3f}"
            )
        interrupted_s = self.interrupted.get(owner)
        # One that it accepted before may wait for its landing or take-off, and the first
        # cancellation may have been lost.
        if interrupted_s is not None and self.accepted[robot, goal_id] > interrupted_s:
            raise Violation(
                f"{now_s:.3f}: {robot} accepted {goal_id} of {owner}, which was interrupted, and "
                f"nothing can have been in transit since {interrupted_s:.3f}"
            )
        silent_s = self.silent_after.get((robot, owner))
        if silent_s is not None and now_s > silent_s:
            raise Violation(
                f"{now_s:.3f}: {robot} begins {goal_id} for {owner}, whose interrupt had returned "
                f"at {silent_s:.3f}"
            )

    def asked(self, now_s: float, robot: str, what: str) -> None:
        """Check that a robot's driver may be asked for something.

        Raises:
            Violation: The robot's motors were cut, and it has not been connected since.
        """
        if robot in self.killed:
            raise Violation(
                f"{now_s:.3f}: {robot} is asked to {what}, and its motors were cut at "
                f"{self.killed[robot]:.3f}"
            )

    def interrupt_returned(self, robot: str, owner: str, at_s: float) -> None:
        """Record that a robot must not begin to move for an owner after `at_s`."""
        self.silent_after[robot, owner] = at_s

    def stop_arrived(self, now_s: float, robot: str, sender: str) -> None:
        """Record that a stop arrived at its robot."""
        self.stops.setdefault((robot, sender), now_s)
        self.excuses.add((robot, "stopped"))

    def stop_confirmed(self, now_s: float, robot: str, sender: str) -> None:
        """Record that a robot confirmed a stop; it must not begin to move until a release."""
        self.tell(now_s, f"{robot} confirms its stop to {sender}")
        if self.released.get(robot, -1.0) <= self.stops[robot, sender]:
            self.stopped_since[robot] = now_s

    def motors_cut(self, now_s: float, robot: str) -> None:
        """Record that the motors of a robot have been cut."""
        self.tell(now_s, f"the motors of {robot} are cut")
        self.killed[robot] = now_s

    def release_taken(self, now_s: float, robot: str) -> None:
        """Record that a robot accepted a release, after which it may move at any time."""
        self.tell(now_s, f"{robot} is released")
        self.stopped_since.pop(robot, None)
        self.released[robot] = now_s

    def release_confirmed(self, now_s: float, robot: str) -> None:
        """Check that a robot which is said to be released is connected.

        Raises:
            Violation: Its motors were cut, and it has not been connected since.
        """
        self.asked(now_s, robot, "be free again")

    def connected(self, now_s: float, robot: str) -> None:
        """Record that a robot is connected.

        Raises:
            Violation: Its motors were cut, and it has not been released since.
        """
        killed_s = self.killed.pop(robot, None)
        if killed_s is not None and self.released.get(robot, -1.0) < killed_s:
            raise Violation(
                f"{now_s:.3f}: {robot} is connected, its motors were cut at {killed_s:.3f}, and "
                "it has not been released since"
            )

    def report(self, now_s: float, robot: str, *, ready: bool) -> None:
        """Record whether a robot is ready, as its agent knows."""
        if ready:
            self.unready.pop(robot, None)
        elif now_s > self.unready.setdefault(robot, now_s) + REFUSAL_PATIENCE_S / 2:
            # Other refusals, before it became unready, count towards the patience as well.
            self.excuses.add((robot, "not-ready"))
