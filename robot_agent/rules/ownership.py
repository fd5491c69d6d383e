"""Who commands a robot: one orchestrator at a time, under an epoch that never falls. Pure.

An orchestrator gets its epochs with its leases of robots, each higher than all before it; 0 says
that it has no lease. So whoever was thought dead and replaced is known by its epoch when it wakes.
Watching a robot, stopping it and releasing it need no epoch.

An epoch is remembered for ever, so that a wrong one would lock everybody else out: one that is far
above the last is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.shared.wire.messages import EPOCH_JUMP_MAX, EPOCH_MAX, Refusal


@dataclass(frozen=True)
class Commander:
    """An orchestrator, and the epoch of its lease; 0 without one."""

    owner: str
    epoch: int = 0


def refusal_to_command(
    held: Commander | None, sender: Commander, *, held_alive: bool, moving_for: str | None
) -> Refusal | None:
    """Return why a robot does not obey, or None when it does.

    Args:
        held: who commanded it last under an epoch; None when nobody ever did.
        sender: who wants to.
        held_alive: whether the liveliness token of `held` is there.
        moving_for: whose motion is in progress, if they are alive; nobody else ends it.
    """
    if held is not None:
        if sender.epoch == 0:
            # Who has no lease is not in the order of epochs; it gives way to whoever has one.
            if held_alive and sender.owner != held.owner:
                return _stale(held, "take a lease to follow it")
        elif sender.epoch < held.epoch:
            return _stale(held, f"epoch {sender.epoch} is over")
        elif sender.epoch == held.epoch and sender.owner != held.owner and held_alive:
            return _stale(held, "take a lease with a higher one")
    highest = EPOCH_MAX if held is None else min(EPOCH_MAX, held.epoch + EPOCH_JUMP_MAX)
    if sender.epoch > highest and sender != held:
        return Refusal(
            code="epoch-jump",
            reason=f"{sender.owner} sent epoch {sender.epoch}, and none above {highest} is obeyed "
            "here; if its repository is right, make the robot forget its owner: "
            "nufleet agent FLEET --robot NAME --forget-owner",
        )
    if takes_over(held, sender) and moving_for not in (None, sender.owner):
        return Refusal(
            code="busy", reason=f"it moves for {moving_for}, who is alive; take it over at rest"
        )
    return None


def takes_over(held: Commander | None, sender: Commander) -> bool:
    """Return whether a sender that is obeyed commands the robot under a new epoch from then on."""
    return sender.epoch > 0 and sender != held


def _stale(held: Commander, hint: str) -> Refusal:
    return Refusal(
        code="stale-epoch", reason=f"{held.owner} commands it under epoch {held.epoch}; {hint}"
    )
