"""Stands in for a journal where there is no folder for one: nothing survives the process."""

from __future__ import annotations

from collections.abc import Iterable

from nufleet.robot_agent.journal.journal import Remembrance
from nufleet.robot_agent.rules.goal_machine import Goal, Goals
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.wire.messages import GoalResult
from nufleet.shared.wire.motions import MotionPlan


class Unrecorded:
    """Takes what a `Journal` takes, and stores none of it."""

    remembrance = Remembrance(goals=Goals(), stop=None, owner=None, lost=(), damage=None)

    def accepted(self, goal: Goal, plan: MotionPlan, boot_id: str) -> None:
        """Forget it."""

    def ended(self, result: GoalResult) -> bool:
        """Forget it; return that its samples are not kept."""
        del result
        return False

    def forgone(self, goal_id: str) -> None:
        """Forget it."""

    def acknowledged(self, goal_ids: Iterable[str]) -> None:
        """Forget it."""

    def stopped(self, order: StopOrder) -> None:
        """Forget it."""

    def released(self, sender: str) -> None:
        """Forget it."""

    def owned(self, owner: str, epoch: int) -> None:
        """Forget it."""

    def result(self, goal_id: str) -> GoalResult | None:
        """Return None: no result is kept."""
        del goal_id
        return None

    def close(self) -> None:
        """Do nothing."""
