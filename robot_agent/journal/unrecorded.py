"""A substitute for the journal of a robot without a state folder: nothing survives the process."""

from __future__ import annotations

from collections.abc import Iterable

from nufleet.robot_agent.journal.journal import Remembrance
from nufleet.robot_agent.rules.goal_machine import Goal, Goals
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.wire.messages import GoalResult
from nufleet.shared.wire.motions import MotionPlan


class Unrecorded:
    """Has the interface of a `Journal`, and stores nothing."""

    remembrance = Remembrance(goals=Goals(), stop=None, owner=None, lost=(), damage=None)

    def accepted(self, goal: Goal, plan: MotionPlan, boot_id: str) -> None:
        """Ignore an accepted goal."""

    def ended(self, result: GoalResult) -> bool:
        """Ignore a goal's end; return False, since its samples are not kept."""
        del result
        return False

    def forgone(self, goal_id: str) -> None:
        """Ignore a goal cancelled before it arrived."""

    def acknowledged(self, goal_ids: Iterable[str]) -> None:
        """Ignore acknowledged results."""

    def stopped(self, order: StopOrder) -> None:
        """Ignore a stop."""

    def released(self, sender: str) -> None:
        """Ignore a release."""

    def owned(self, owner: str, epoch: int) -> None:
        """Ignore a change of owner."""

    def result(self, goal_id: str) -> GoalResult | None:
        """Return None: no result is kept."""
        del goal_id
        return None

    def close(self) -> None:
        """Do nothing."""
