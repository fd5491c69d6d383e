"""Decides which orchestrator commands a robot: one at a time, with epochs that never fall. Pure.

An orchestrator receives an epoch with each lease of a robot, higher than all before it; 0 means
that it has no lease. An orchestrator that was thought dead and replaced is thus recognised by its
lower epoch when it wakes. Watching a robot, stopping it and releasing it need no epoch.

A robot keeps its epoch for ever, so a wrong one would lock every other orchestrator out. An epoch
far above the last one is therefore refused.

A motion of a live orchestrator is not ended by a higher epoch, but it is the last one under the
lower epoch: the orchestrator that waits commands the robot next.
"""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.wire.messages import EPOCH_JUMP_MAX, EPOCH_MAX, Refusal


@dataclass(frozen=True)
class Commander:
    """An orchestrator with the epoch under which it commands a robot."""

    owner: str
    """Name of the orchestrator."""

    epoch: int = 0
    """Epoch of its lease; 0 without a lease."""


def refusal_to_command(
    held: Commander | None, sender: Commander, *, held_alive: bool, moving_for: str | None
) -> Refusal | None:
    """Return why a robot does not obey a sender; None when it does.

    Args:
        held: Orchestrator that last commanded the robot under an epoch; None when there was none.
        sender: Orchestrator that asks to command it.
        held_alive: Whether the liveliness token of `held` is present.
        moving_for: Owner of the motion in progress, if it is alive; no other orchestrator ends that
            motion. None when the robot is at rest or the owner is gone.
    """
    if held is not None:
        if sender.epoch == 0:
            # A sender without a lease has no place in the order of epochs; it gives way to a live
            # orchestrator with a lease.
            if held_alive and sender.owner != held.owner:
                return _stale(held, "take a lease to command it next")
        elif sender.epoch < held.epoch:
            return _stale(held, f"epoch {sender.epoch} is over")
        elif sender.epoch == held.epoch and sender.owner != held.owner and held_alive:
            return _stale(held, "take a lease with a higher one")
    highest = EPOCH_MAX if held is None else min(EPOCH_MAX, held.epoch + EPOCH_JUMP_MAX)
    if sender.epoch > highest and sender != held:
        return Refusal(
            code="epoch-jump",
            reason=f"{sender.owner} sent epoch {sender.epoch}, and this robot accepts none above "
            f"{highest}; if the repository is right, make the robot forget its owner: "
            "nufleet agent FLEET --robot NAME --forget-owner",
        )
    if takes_over(held, sender) and moving_for not in (None, sender.owner):
        return Refusal(
            code="busy",
            reason=f"it is moving for {moving_for}, which is alive; take over when it is at rest",
        )
    return None


def waiting_next(
    waiting: Commander | None, sender: Commander, refusal: Refusal | None
) -> Commander | None:
    """Return which orchestrator waits for a robot's motion to end, after one more was answered.

    Args:
        waiting: Orchestrator that waited before; None when there was none.
        sender: Orchestrator that asked to command the robot.
        refusal: Answer to it by `refusal_to_command`.
    """
    if refusal is None or refusal.code != "busy":
        return waiting
    return sender if waiting is None or sender.epoch > waiting.epoch else waiting


def refusal_to_begin(
    waiting: Commander | None, sender: Commander, *, waiting_alive: bool
) -> Refusal | None:
    """Return why a robot begins nothing new for a sender that it obeys; None when it does.

    Without this rule, an orchestrator under a lower epoch could keep a robot for ever by sending
    each goal as soon as the one before has ended.

    Args:
        waiting: Orchestrator that waits for the robot; None when there is none.
        sender: Orchestrator that asks for a motion.
        waiting_alive: Whether the liveliness token of `waiting` is present.
    """
    if waiting is None or not waiting_alive or sender.epoch >= waiting.epoch:
        return None
    return Refusal(
        code="stale-epoch",
        reason=f"{waiting.owner} commands it next under epoch {waiting.epoch}; "
        f"epoch {sender.epoch} is over",
    )


def takes_over(held: Commander | None, sender: Commander) -> bool:
    """Return whether a sender that is obeyed commands the robot under a new epoch from now on."""
    return sender.epoch > 0 and sender != held


def _stale(held: Commander, hint: str) -> Refusal:
    return Refusal(
        code="stale-epoch", reason=f"{held.owner} commands it under epoch {held.epoch}; {hint}"
    )
