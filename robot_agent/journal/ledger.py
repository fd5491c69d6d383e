"""The records of a robot's journal, and the state they add up to: goals, stop and owner. Pure.

A record is a fact in the past tense. Applying the records again from the first gives the same
ledger, and `records` gives a shorter journal with the same content.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from itertools import islice
from typing import Annotated, Literal

from pydantic import Field, TypeAdapter, ValidationError

from nufleet.robot_agent.rules.goal_machine import REMEMBERED_GOALS, Goal
from nufleet.robot_agent.rules.kept_results import KEPT_RESULT_BYTES, KEPT_RESULTS
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.errors import NufleetError
from nufleet.shared.strict import Identifier, Reason, Strict, describe_validation
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.motions import MotionPlan

Digest = Annotated[str, Field(max_length=64)]
Count = Annotated[int, Field(ge=0)]


class JournalError(NufleetError):
    """The journal cannot be read or written; a fact that is not stored must not be acted on."""


class Accepted(Strict):
    """A goal was accepted, and its motion may have begun at any time after."""

    kind: Literal["accepted"] = "accepted"
    """Discriminator of the record's type."""

    goal_id: Identifier
    """Id of the goal."""

    owner: Identifier
    """Name of the orchestrator that sent it."""

    digest: Digest
    """Hash of the motion requested."""

    boot_id: Identifier
    """Id of the agent process that accepted it."""

    plan: MotionPlan
    """Plan of its motion."""


class Ended(Strict):
    """A goal's motion is over."""

    kind: Literal["ended"] = "ended"
    """Discriminator of the record's type."""

    goal_id: Identifier
    """Id of the goal."""

    outcome: Outcome
    """How the motion ended."""

    sha256: Digest | None
    """Digest of the file with the goal's result; None without a file."""

    size_bytes: Count
    """Size of that file; 0 without a file."""


class Remembered(Strict):
    """A goal that has ended, as one record of a compacted journal."""

    kind: Literal["remembered"] = "remembered"
    """Discriminator of the record's type."""

    goal_id: Identifier
    """Id of the goal."""

    owner: Annotated[str, Field(max_length=200)]
    """Name of the orchestrator that sent it; empty for a goal whose acceptance is unknown."""

    digest: Digest
    """Hash of the motion requested; empty for a goal whose acceptance is unknown."""

    outcome: Outcome
    """How the motion ended."""

    sha256: Digest | None
    """Digest of the file with the goal's result; None without a file."""

    size_bytes: Count
    """Size of that file; 0 without a file."""


class Acknowledged(Strict):
    """The results of these goals arrived at the orchestrator."""

    kind: Literal["acknowledged"] = "acknowledged"
    """Discriminator of the record's type."""
    goal_ids: Annotated[tuple[Identifier, ...], Field(max_length=64)]
    """Ids of the goals whose results arrived."""


class Stopped(Strict):
    """The robot was stopped; it stays stopped until a release."""

    kind: Literal["stopped"] = "stopped"
    """Discriminator of the record's type."""

    sender: Identifier
    """Name of the sender of the stop."""

    reason: Reason
    """Reason that the sender gave."""


class Released(Strict):
    """The stop was ended; the robot may move again."""

    kind: Literal["released"] = "released"
    """Discriminator of the record's type."""
    sender: Identifier
    """Name of the sender of the release."""


class Owned(Strict):
    """An orchestrator took command of the robot under an epoch; lower epochs are over."""

    kind: Literal["owned"] = "owned"
    """Discriminator of the record's type."""

    owner: Identifier
    """Name of the orchestrator."""

    epoch: Count
    """Epoch of its lease."""


Record = Accepted | Ended | Remembered | Acknowledged | Stopped | Released | Owned
_RECORD: TypeAdapter[Record] = TypeAdapter(Annotated[Record, Field(discriminator="kind")])


def encode_record(record: Record) -> bytes:
    """Return a record as the payload of a frame."""
    return record.model_dump_json().encode()


def decode_record(payload: bytes) -> Record:
    """Return the record in a frame's payload; raises JournalError."""
    try:
        return _RECORD.validate_json(payload)
    except ValidationError as error:
        raise JournalError(
            "the journal holds a record of a different version of nufleet "
            f"({describe_validation(error)}); install the version that wrote it, or inspect the "
            "robot and then move the journal away"
        ) from error


@dataclass(frozen=True)
class LedgerGoal:
    """A goal with the facts that the journal holds about it."""

    goal: Goal
    """The goal itself."""

    boot_id: str = ""
    """Id of the agent process that runs it; empty once it has ended."""

    plan: MotionPlan | None = None
    """Plan of its motion; None once it has ended."""

    sha256: str | None = None
    """Digest of the file with its result; None when none is kept."""

    size_bytes: int = 0
    """Size of that file."""


class Ledger:
    """The state that the records add up to, within bounds: the oldest results and goals go first.

    `goals` are all goals known, by id; `stop` is the stop in force; `owner` is the orchestrator
    that last commanded the robot.
    """

    def __init__(self) -> None:
        # Goals that have ended are in the order of their ends; the running one is among them.
        self.goals: OrderedDict[str, LedgerGoal] = OrderedDict()
        self.stop: StopOrder | None = None
        self.owner: Owned | None = None
        self._kept: OrderedDict[str, int] = OrderedDict()

    @property
    def running(self) -> tuple[LedgerGoal, ...]:
        """Goals that were accepted and have not ended."""
        return tuple(goal for goal in self.goals.values() if goal.goal.outcome is None)

    @property
    def kept(self) -> tuple[str, ...]:
        """Ids of the goals whose results are kept, oldest first."""
        return tuple(self._kept)

    def says_already(self, record: Record) -> bool:
        """Return whether a record would change nothing, as a second stop would."""
        match record:
            case Ended():
                known = self.goals.get(record.goal_id)
                return known is not None and known.goal.outcome is not None
            case Acknowledged():
                return not any(goal_id in self._kept for goal_id in record.goal_ids)
            case Stopped():
                return self.stop is not None
            case Released():
                return self.stop is None
            case Owned():
                return self.owner == record
            case _:
                return False

    def apply(self, record: Record) -> tuple[str, ...]:
        """Apply a record; return the ids of the goals whose results can now be removed."""
        match record:
            case Accepted():
                goal = Goal(record.goal_id, record.owner, record.digest)
                # An acceptance after the goal's end comes from damage only; the end stands.
                known = LedgerGoal(goal, record.boot_id, record.plan)
                self.goals.setdefault(record.goal_id, known)
            case Ended():
                # If damage destroyed the acceptance, the goal becomes known here, with a digest
                # that matches no content, so that the goal is refused if it is sent again.
                unknown = LedgerGoal(Goal(record.goal_id, "", ""))
                goal = self.goals.get(record.goal_id, unknown).goal
                self._keep(replace(goal, outcome=record.outcome), record.sha256, record.size_bytes)
            case Remembered():
                goal = Goal(record.goal_id, record.owner, record.digest, record.outcome)
                self._keep(goal, record.sha256, record.size_bytes)
            case Acknowledged():
                return self._let_go(record.goal_ids)
            case Stopped():
                # As in the supervisor, the first order remains the reason that is shown.
                self.stop = self.stop or StopOrder(record.sender, record.reason)
            case Released():
                self.stop = None
            case Owned():
                self.owner = record
        return self._let_go(self._over_the_bounds())

    def records(self) -> Iterator[Record]:
        """Yield the fewest records that give the same ledger."""
        for known in self.goals.values():
            goal = known.goal
            if goal.outcome is not None:
                yield Remembered(
                    goal_id=goal.goal_id,
                    owner=goal.owner,
                    digest=goal.digest,
                    outcome=goal.outcome,
                    sha256=known.sha256,
                    size_bytes=known.size_bytes,
                )
            elif known.plan is not None:
                yield Accepted(
                    goal_id=goal.goal_id,
                    owner=goal.owner,
                    digest=goal.digest,
                    boot_id=known.boot_id,
                    plan=known.plan,
                )
        if self.stop is not None:
            yield Stopped(sender=self.stop.sender, reason=self.stop.reason)
        if self.owner is not None:
            yield self.owner

    def _keep(self, goal: Goal, sha256: str | None, size_bytes: int) -> None:
        known = self.goals.get(goal.goal_id)
        if known is not None and known.goal.outcome is not None:
            return
        self.goals.pop(goal.goal_id, None)
        self.goals[goal.goal_id] = LedgerGoal(goal, sha256=sha256, size_bytes=size_bytes)
        if sha256 is not None:
            self._kept[goal.goal_id] = size_bytes

    def _over_the_bounds(self) -> Iterator[str]:
        results, size_bytes = len(self._kept), sum(self._kept.values())
        for goal_id, result_bytes in list(self._kept.items())[:-1]:
            if results <= KEPT_RESULTS and size_bytes <= KEPT_RESULT_BYTES:
                break
            results, size_bytes = results - 1, size_bytes - result_bytes
            yield goal_id
        ended = (key for key, known in self.goals.items() if known.goal.outcome is not None)
        for goal_id in list(islice(ended, max(0, len(self.goals) - REMEMBERED_GOALS))):
            yield goal_id
            del self.goals[goal_id]

    def _let_go(self, goal_ids: Iterable[str]) -> tuple[str, ...]:
        gone = tuple(goal_id for goal_id in dict.fromkeys(goal_ids) if goal_id in self._kept)
        for goal_id in gone:
            del self._kept[goal_id]
            if goal_id in self.goals:
                self.goals[goal_id] = LedgerGoal(self.goals[goal_id].goal)
        return gone
