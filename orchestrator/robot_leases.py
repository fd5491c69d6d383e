"""Takes robots for an orchestrator: by the repository's leases, and as the robots say."""

from __future__ import annotations

import functools
from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING

from orchestrator.fleet import Fleet
from orchestrator.held_leases import HeldLeases, hold_leases
from orchestrator.repository.errors import LeaseHeldError
from orchestrator.repository.records import LastLease
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

    A robot remembers who commanded it and under which epoch. Epochs of two repositories cannot be
    compared, so an owner to whom this one did not give exactly that lease keeps another; and the
    clock by which a lease ran out may have been set. In both cases the network is asked whether the
    owner is alive, and a living owner keeps its robot.

    Args:
        store: the repository's leases.
        fleet: the fleet, reached; commands carry the leases' epochs from now on.
        scope: the name under which its robots are leased.
        robots: who is to be commanded.
        patient: whether to wait for an owner that is not heard of any more.
        on_wait: is told once for whom.

    Raises:
        LeaseHeldError: another orchestrator owns one of them; it says who and for how long.
        RobotOwnedError: one does that keeps another repository, or whose lease ran out although it
            is alive.
        NoReplyError: a robot does not answer.
    """
    descriptions = fleet.describe_all(tuple(robots))
    _check_others(fleet, descriptions, store.last(scope))
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
    fleet: Fleet, descriptions: Mapping[str, Description], given: Mapping[str, LastLease]
) -> None:
    is_alive = functools.cache(fleet.is_alive)
    for robot, found in descriptions.items():
        ours = given.get(robot)
        suspects: dict[str, str] = {}
        if found.owner is not None and (
            ours is None or (found.owner, found.epoch) != (ours.owner, ours.epoch)
        ):
            suspects[found.owner] = (
                f"commanded by {found.owner} (epoch {found.epoch}), who keeps another repository; "
                "wait until it has ended, or share one repository with --repository"
            )
        if ours is not None and ours.silent:
            suspects[ours.owner] = (
                f"owned by {ours.owner} (epoch {ours.epoch}), who is alive although its lease ran "
                "out; wait until it has ended or renewed it, or end it"
            )
        for owner, why in suspects.items():
            if owner != fleet.orchestrator_id and is_alive(owner):
                raise RobotOwnedError(f"robot {robot} is {why}")
