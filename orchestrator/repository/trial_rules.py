"""What may happen to a trial, as pure functions over its record."""

from __future__ import annotations

from dataclasses import replace

from nufleet.orchestrator.repository.errors import (
    RecordConflictError,
    StaleEpochError,
    TrialEndedError,
)
from nufleet.orchestrator.repository.records import TrialIntent, TrialRecord, TrialStatus


def check_same_intent(known: TrialRecord, intent: TrialIntent) -> None:
    """Check that an intent that is stored again is the one that was stored.

    A later epoch takes the trial over; everything else must be the same.

    Raises:
        RecordConflictError: the goal id is taken by another test.
        StaleEpochError: a later owner has taken the trial over.
    """
    check_epoch(known, intent.epoch)
    if replace(known.intent, epoch=intent.epoch) != intent:
        raise RecordConflictError(
            f"goal {intent.goal_id} is stored already, with another test, robot or place"
        )


def check_epoch(known: TrialRecord, epoch: int) -> None:
    """Check that whoever writes about a trial is its latest owner; raises StaleEpochError."""
    if epoch < known.intent.epoch:
        raise StaleEpochError(
            f"goal {known.intent.goal_id}: epoch {epoch} is over, robot {known.intent.robot} "
            f"belongs to epoch {known.intent.epoch}; this process must stop commanding it"
        )


def is_new_acceptance(known: TrialRecord, boot_id: str) -> bool:
    """Return whether an acceptance is to be stored; False when it is stored already.

    Raises:
        TrialEndedError: the trial has ended, or another agent process has accepted it, which then
            died with it.
    """
    if known.status is TrialStatus.INTENDED:
        return True
    if known.status is TrialStatus.ACCEPTED and known.boot_id == boot_id:
        return False
    raise TrialEndedError(
        f"goal {known.intent.goal_id} cannot be accepted by boot {boot_id}: it is {known.status}"
        f" at boot {known.boot_id}; send a new attempt"
    )


def is_new_end(known: TrialRecord, status: TrialStatus) -> bool:
    """Return whether an end is to be stored; False when the trial has ended so already.

    The same end again is what a process sends that never learned whether it was stored; the first
    one stays.

    Raises:
        TrialEndedError: the trial has ended in another way.
    """
    if not known.status.ended:
        return True
    if known.status is status:
        return False
    raise TrialEndedError(
        f"goal {known.intent.goal_id} has ended as {known.status} and cannot be {status} any more"
    )
