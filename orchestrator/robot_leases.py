"""Takes robots for an orchestrator: by the repository's leases, and as the robots say."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

from orchestrator.fleet import Fleet
from orchestrator.held_leases import HeldLeases, hold_leases
from orchestrator.repository.errors import LeaseHeldError
from shared.errors import RobotOwnedError
from shared.messages import Description

if TYPE_CHECKING:
    from orchestrator.repository.lease_store import LeaseStore


def lease_robots(
    store: LeaseStore,
    fleet: Fleet,
    scope: str,
    robots: Iterable[str],
    *,
    patient: bool = False,
    on_wait: Callable[[LeaseHeldError], None] = lambda held: None,
) -> HeldLeases:
    """Take robots, so that only this orchestrator commands them; enter what is returned.

    A robot remembers under which epoch it was commanded. An epoch that this repository never gave
    out is another repository's: while its owner is alive, the robot is left to it.

    Args:
        store: the repository's leases.
        fleet: the fleet, reached; commands carry the leases' epochs from now on.
        scope: the name under which its robots are leased.
        robots: who is to be commanded.
        patient: whether to wait for an owner that is not heard of any more.
        on_wait: is told once for whom.

    Raises:
        LeaseHeldError: another orchestrator owns one of them; it says who and for how long.
        RobotOwnedError: one that keeps another repository does.
        NoReplyError: a robot does not answer.
    """
    descriptions = fleet.describe_all(tuple(robots))
    _check_others(fleet, descriptions, store.epochs(scope))
    leases = hold_leases(
        store,
        scope,
        descriptions,
        owner=fleet.orchestrator_id,
        above_epochs={robot: found.epoch for robot, found in descriptions.items()},
        patient=patient,
        on_wait=on_wait,
    )
    fleet.hold(leases.epochs)
    return leases


def _check_others(
    fleet: Fleet, descriptions: Mapping[str, Description], given: Mapping[str, int]
) -> None:
    for robot, found in descriptions.items():
        owner = found.owner
        if owner in (None, fleet.orchestrator_id) or found.epoch <= given.get(robot, 0):
            continue
        if fleet.is_alive(owner):
            raise RobotOwnedError(
                f"robot {robot} is commanded by {owner} (epoch {found.epoch}), who keeps another "
                "repository; wait until it has ended, or share one repository with --repository"
            )
