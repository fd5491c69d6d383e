"""Whose turn it is to command a robot once its motion has ended."""

from __future__ import annotations

from dataclasses import dataclass

from benchmarks.faults.simulation.history import Violation
from nufleet.robot_agent.rules.ownership import WAITS_S
from nufleet.shared.wire.messages import GoalRequest


@dataclass
class Turn:
    """The orchestrator that a robot has refused because it moves, and that commands it next."""

    robot: str
    """Name of the robot."""

    waits: GoalRequest | None = None
    """Latest refused request under the highest epoch; None when no orchestrator waits."""

    asked_s: float = 0.0
    """Time of that request."""

    def refused(self, request: GoalRequest, now_s: float) -> None:
        """Record that a request was refused because the robot moves."""
        if not self._comes_after(request, now_s):
            self.waits, self.asked_s = request, now_s

    def accepted(self, request: GoalRequest, now_s: float) -> None:
        """Check that no other orchestrator waits for its turn; raises Violation if one does."""
        if self.waits is not None and self._comes_after(request, now_s):
            raise Violation(
                f"{now_s:.3f}: {self.robot} accepts {request.goal_id} of {request.owner}, and "
                f"{self.waits.owner} waits for it"
            )

    def lost(self, owner: str) -> None:
        """Record that an orchestrator is gone, which waits no longer."""
        if self.waits is not None and self.waits.owner == owner:
            self.waits = None

    def _comes_after(self, request: GoalRequest, now_s: float) -> bool:
        waits = self.waits
        in_time = now_s <= self.asked_s + WAITS_S
        return waits is not None and in_time and waits.epoch > request.epoch
