"""Decides which orchestrator commands a robot: one at a time, with epochs that never fall. Pure.

An orchestrator receives an epoch with each lease of a robot, higher than all before it; 0 means
that it has no lease. An orchestrator that was thought dead and replaced is thus recognised by its
lower epoch when it wakes. Watching a robot, stopping it and releasing it need no epoch.

A robot keeps its epoch for ever, so a wrong one would lock every other orchestrator out. An epoch
far above the last one is therefore refused.

A motion of a live orchestrator is not ended by a higher epoch, but it is the last one under the
lower epoch: the orchestrator that waits commands the robot next. It waits for as long as it keeps
asking; one that has given up, or is gone, keeps no other from the robot.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from nufleet.shared.wire.messages import EPOCH_JUMP_MAX, EPOCH_MAX, Refusal


@dataclass(frozen=True)
class Commander:
    """An orchestrator with the epoch under which it commands a robot."""

    owner: str
    """Name of the orchestrator."""

    epoch: int = 0
    """Epoch of its lease; 0 without a lease."""


WAITS_S = 5.0
"""Time in s after which an orchestrator that has not asked again no longer waits.

One that is there asks again after 3 s even if an answer is lost. The others put up with a busy
robot for much longer, so that no study loses a robot to one that has given up.
"""


@dataclass(frozen=True)
class Waiting:
    """An orchestrator that waits for a robot to come to rest, to command it next."""

    commander: Commander
    """The orchestrator."""

    asked_s: float
    """Time in s at which it last asked for the robot."""


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
    waiting: Waiting | None,
    sender: Commander,
    refusal: Refusal | None,
    *,
    held: Commander | None,
    alive: Collection[str],
    now_s: float,
) -> Waiting | None:
    """Return which orchestrator waits for a robot's motion to end, after one more was answered.

    Args:
        waiting: Orchestrator that waited before; None when there was none.
        sender: Orchestrator that asked to command the robot.
        refusal: Answer to it by `refusal_to_command`.
        held: Orchestrator that last commanded the robot under an epoch; None when there was none.
        alive: Names of the orchestrators whose liveliness tokens are present.
        now_s: Current time in s, on the clock of `waiting`.
    """
    if waiting is not None and (
        now_s > waiting.asked_s + WAITS_S
        or waiting.commander.owner not in alive
        or (held is not None and held.epoch >= waiting.commander.epoch)
    ):
        waiting = None
    if refusal is None or refusal.code != "busy" or sender.owner not in alive:
        return waiting
    if waiting is not None and waiting.commander.epoch > sender.epoch:
        return waiting
    return Waiting(sender, now_s)


def refusal_to_begin(waiting: Waiting | None, sender: Commander) -> Refusal | None:
    """Return why a robot begins nothing new for a sender that it obeys; None when it does.

    Without this rule, an orchestrator under a lower epoch could keep a robot for ever by sending
    each goal as soon as the one before has ended. The refusal is for the moment: the orchestrator
    that waits either takes the robot over, or stops asking.

    Args:
        waiting: Orchestrator that waits for the robot; None when there is none.
        sender: Orchestrator that asks for a motion.
    """
    if waiting is None or sender.epoch >= waiting.commander.epoch:
        return None
    owner, epoch = waiting.commander.owner, waiting.commander.epoch
    return Refusal(code="busy", reason=f"{owner} waits for it and commands it next, epoch {epoch}")


def takes_over(held: Commander | None, sender: Commander) -> bool:
    """Return whether a sender that is obeyed commands the robot under a new epoch from now on."""
    return sender.epoch > 0 and sender != held


def _stale(held: Commander, hint: str) -> Refusal:
    return Refusal(
        code="stale-epoch", reason=f"{held.owner} commands it under epoch {held.epoch}; {hint}"
    )
