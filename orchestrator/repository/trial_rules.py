"""The permitted changes of a trial, as pure functions of its record."""

from __future__ import annotations

from dataclasses import replace

from nufleet.orchestrator.repository.errors import (
    RecordConflictError,
    StaleEpochError,
    TrialEndedError,
)
from nufleet.orchestrator.repository.records import TrialIntent, TrialRecord, TrialStatus


def check_same_intent(known: TrialRecord, intent: TrialIntent) -> None:
    """Check that an intent that is stored again equals the stored one.

    A later epoch takes over the trial; everything else must be equal.

    Raises:
        RecordConflictError: The goal id is taken by another test.
        StaleEpochError: A later owner has taken over the trial.
    """
    check_epoch(known, intent.epoch)
    if replace(known.intent, epoch=intent.epoch) != intent:
        raise RecordConflictError(
            f"goal {intent.goal_id} is already stored, with a different test, robot or place"
        )


def check_epoch(known: TrialRecord, epoch: int) -> None:
    """Check that a write about a trial comes from its latest owner; raises StaleEpochError."""
    if epoch < known.intent.epoch:
        raise StaleEpochError(
            f"goal {known.intent.goal_id}: epoch {epoch} is over, robot {known.intent.robot} "
            f"belongs to epoch {known.intent.epoch}; this process must stop commanding it"
        )


def is_new_acceptance(known: TrialRecord, boot_id: str) -> bool:
    """Return whether an acceptance is to be stored; False when it is stored already.

    Raises:
        TrialEndedError: The trial has ended, or it was accepted by another agent process and died
            with that process.
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
    """Return whether an end is to be stored; False when the trial has already ended in that way.

    A process that never learned whether an end was stored sends the same end again; the first one
    is kept.

    Raises:
        TrialEndedError: The trial has ended in another way.
    """
    if not known.status.ended:
        return True
    if known.status is status:
        return False
    raise TrialEndedError(
        f"goal {known.intent.goal_id} has ended as {known.status} and can no longer be {status}"
    )
