"""A robot's disk: the journal's ledger and the kept results, which outlive its agents."""

from __future__ import annotations

from collections.abc import Iterable
from types import MappingProxyType

from nufleet.robot_agent.journal.journal import Remembrance, lost_result
from nufleet.robot_agent.journal.ledger import (
    Accepted,
    Acknowledged,
    Ended,
    JournalError,
    Ledger,
    Owned,
    Record,
    Released,
    Stopped,
)
from nufleet.robot_agent.rules.goal_machine import Goal, Goals
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.wire.messages import GoalResult, Outcome
from nufleet.shared.wire.motions import MotionPlan


class Disk:
    """The disk of a robot, which outlives its agents: the journal's ledger and the kept results."""

    def __init__(self) -> None:
        self.ledger = Ledger()
        self.results: dict[str, GoalResult] = {}
        self.full = False


class DiskJournal:
    """A `Journal` on a simulated disk: a record is stored whole or refused."""

    def __init__(self, disk: Disk) -> None:
        self._disk = disk
        lost = tuple(known.goal.goal_id for known in disk.ledger.running)
        for known in disk.ledger.running:
            result = lost_result(known)
            disk.results[known.goal.goal_id] = result
            disk.ledger.apply(_ended(result))
        goals = {goal_id: known.goal for goal_id, known in disk.ledger.goals.items()}
        self.remembrance = Remembrance(
            Goals(MappingProxyType(goals)), disk.ledger.stop, disk.ledger.owner, lost, None
        )

    def accepted(self, goal: Goal, plan: MotionPlan, boot_id: str) -> None:
        self._append(
            Accepted.model_construct(
                goal_id=goal.goal_id,
                owner=goal.owner,
                digest=goal.digest,
                boot_id=boot_id,
                plan=plan,
            )
        )

    def ended(self, result: GoalResult) -> bool:
        self._append(_ended(result))
        self._disk.results[result.goal_id] = result
        return True

    def forgone(self, goal_id: str) -> None:
        self._append(
            Ended.model_construct(
                goal_id=goal_id, outcome=Outcome.CANCELLED, sha256=None, size_bytes=0
            )
        )

    def acknowledged(self, goal_ids: Iterable[str]) -> None:
        self._append(Acknowledged.model_construct(goal_ids=tuple(goal_ids)))

    def stopped(self, order: StopOrder) -> None:
        self._append(Stopped.model_construct(sender=order.sender, reason=order.reason))

    def released(self, sender: str) -> None:
        self._append(Released.model_construct(sender=sender))

    def owned(self, owner: str, epoch: int) -> None:
        self._append(Owned.model_construct(owner=owner, epoch=epoch))

    def result(self, goal_id: str) -> GoalResult | None:
        return self._disk.results.get(goal_id)

    def close(self) -> None:
        """Do nothing: no file is open."""

    def _append(self, record: Record) -> None:
        if self._disk.ledger.says_already(record):
            return
        if self._disk.full:
            raise JournalError("no space left on the device")
        for goal_id in self._disk.ledger.apply(record):
            self._disk.results.pop(goal_id, None)


def _ended(result: GoalResult) -> Ended:
    return Ended.model_construct(
        goal_id=result.goal_id, outcome=result.outcome, sha256="0" * 64, size_bytes=1
    )
