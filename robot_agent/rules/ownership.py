"""Decides which orchestrator commands a robot: one at a time, with epochs that never fall. Pure.

An orchestrator receives an epoch with each lease of a robot, higher than all before it; 0 means
that it has no lease. An orchestrator that was thought dead and replaced is thus recognised by its
lower epoch when it wakes. Watching a robot, stopping it and releasing it need no epoch.

A robot keeps its epoch for ever, so a wrong one would lock every other orchestrator out. An epoch
far above the last one is therefore refused.
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


def takes_over(held: Commander | None, sender: Commander) -> bool:
    """Return whether a sender that is obeyed commands the robot under a new epoch from now on."""
    return sender.epoch > 0 and sender != held


def _stale(held: Commander, hint: str) -> Refusal:
    return Refusal(
        code="stale-epoch", reason=f"{held.owner} commands it under epoch {held.epoch}; {hint}"
    )
