"""Leases on robots: taken before a study, renewed while it runs, released at its end."""

from __future__ import annotations

import functools
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from typing import TYPE_CHECKING

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import Interrupted
from nufleet.orchestrator.repository.errors import LeaseHeldError, LeaseLostError, RepositoryError
from nufleet.orchestrator.repository.records import LastLease, Lease, Renewal
from nufleet.shared.errors import NufleetError, RobotOwnedError
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.lease_store import LeaseStore


TERM_S = 8.0
"""How long a lease stays valid without renewal, in s.

A robot is therefore blocked for this long after its owner dies, and the database may be
unreachable for this long during a study.
"""

RENEW_EVERY_S = 2.0
"""Interval between renewals, in s; several of them fit into one term."""

_LOOK_EVERY_S = 0.2
"""Interval between attempts to acquire a lease that another orchestrator holds, in s."""

_log = logging.getLogger(__name__)


class HeldLeases:
    """A context manager that renews leases in a background thread and releases them on exit.

    When a lease is lost, another orchestrator owns the robots: every operation that moves them is
    interrupted.
    """

    def __init__(self, store: LeaseStore, leases: tuple[Lease, ...]) -> None:
        self.epochs: Mapping[str, int] = {lease.robot: lease.epoch for lease in leases}
        self._store = store
        self._leases = leases
        self._lock = threading.Lock()
        self._lost: LeaseLostError | None = None
        self._interrupts: list[Callable[[], None]] = []
        self._released = threading.Event()
        self._thread = threading.Thread(target=self._renew, name="leases", daemon=True)

    def __enter__(self) -> HeldLeases:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._released.set()
        self._thread.join()
        self.give_back()

    def give_back(self) -> None:
        """Release the leases; needed only where the context was never entered, as exit does it."""
        try:
            self._store.release(self._leases)
        except RepositoryError as problem:
            _log.warning("others have to wait until the leases expire: %s", problem)

    @contextmanager
    def guarding(self, interrupt: Callable[[], None]) -> Iterator[None]:
        """Interrupt the enclosed operation as soon as a lease is lost, and raise the reason.

        Args:
            interrupt: Function that makes the operation raise `Interrupted`; it is called from the
                renewing thread.

        Raises:
            LeaseLostError: Another orchestrator has taken over a robot, or the lease could not be
                renewed for a whole term.
        """
        with self._lock:
            self._interrupts.append(interrupt)
            lost = self._lost is not None
        if lost:
            interrupt()
        try:
            yield
        except Interrupted:
            if self._lost is not None:
                raise self._lost from None
            raise

    def _renew(self) -> None:
        held_until_s = time.monotonic() + TERM_S
        while not self._released.wait(RENEW_EVERY_S):
            asked_s = time.monotonic()
            try:
                self._store.renew(self._leases)
            except LeaseLostError as error:
                return self._lose(error)
            except RepositoryError as error:
                if time.monotonic() >= held_until_s:
                    first = self._leases[0]
                    reason = f"it could not be renewed for {TERM_S:g} s: {error}"
                    return self._lose(LeaseLostError(first.robot, first.owner, first.epoch, reason))
                _log.warning("the leases could not be renewed yet: %s", error)
            else:
                held_until_s = asked_s + TERM_S
        return None

    def _lose(self, error: LeaseLostError) -> None:
        _log.error("%s; the robots come to rest", error)
        with self._lock:
            self._lost = error
            interrupts = list(self._interrupts)
        for interrupt in interrupts:
            interrupt()


def hold_leases(
    store: LeaseStore,
    fleet: str,
    robots: Iterable[str],
    *,
    owner: str,
    above_epochs: Mapping[str, int] | None = None,
    patient: bool = False,
    on_wait: Callable[[LeaseHeldError], None] = lambda held: None,
) -> HeldLeases:
    """Acquire leases on robots for this orchestrator.

    Args:
        store: Lease store of the repository.
        fleet: Name under which the robots are leased.
        robots: Names of the robots to be commanded.
        owner: Id of this orchestrator.
        above_epochs: Latest epoch that each robot has seen, by robot.
        patient: Whether to wait for an owner that may no longer renew its leases; one that renews
            is alive, which ends the wait with an error. After the database's clock was set back
            there is always a wait, since nothing else distinguishes a dead owner from a living one.
        on_wait: Callback that receives, once per lease, the lease that is being waited for.

    Returns:
        The acquired leases; enter the context to keep them renewed.

    Raises:
        LeaseHeldError: Another orchestrator owns one of the robots; the error holds its id and the
            remaining time.
    """
    names = tuple(robots)
    # When each foreign lease was first seen with its present renewal, by the monotonic clock of
    # this process: unlike the database's wall clock, it cannot be set.
    watched: dict[tuple[str, str, int], tuple[Renewal, float]] = {}
    while True:
        now_s = time.monotonic()
        silent = [found for found, since_s in watched.values() if now_s - since_s > found.term_s]
        try:
            leases = store.acquire(
                fleet, names, owner=owner, term_s=TERM_S, above_epochs=above_epochs, silent=silent
            )
            return HeldLeases(store, leases)
        except LeaseHeldError as held:
            set_back = any(renewal.before_set_back for renewal in held.renewals)
            if not (patient or set_back):
                raise
            if (held.robot, held.owner, held.epoch) not in watched:
                on_wait(held)
            for renewal in held.renewals:
                key = (renewal.robot, renewal.owner, renewal.epoch)
                if watched.setdefault(key, (renewal, now_s))[0] != renewal:
                    raise  # renewed since the last look, so its owner is alive
        time.sleep(_LOOK_EVERY_S)


def lease_robots(
    store: LeaseStore,
    fleet: Fleet,
    scope: str,
    descriptions: Mapping[str, Description],
    *,
    patient: bool = False,
    on_wait: Callable[[LeaseHeldError], None] = lambda held: None,
) -> HeldLeases:
    """Acquire leases on robots, so that this orchestrator alone commands them.

    Each robot stores its last owner and that owner's epoch. Epochs of two repositories cannot be
    compared, so an owner to whom this repository did not grant exactly that lease must be using
    another repository; and a lease may appear to have expired only because the clock was set. In
    both cases the network is asked whether the owner is alive, and a living owner keeps its robot.

    A description that has become outdated cannot give a robot two owners: the robot refuses an
    epoch below the one it knows, the same epoch of another living owner, and any owner while it
    moves for another that is alive. Robots are described again only after a wait, which lasts long
    enough for the descriptions to be wrong.

    Args:
        store: Lease store of the repository.
        fleet: Client of the fleet, already connected; its commands carry the epochs of these leases
            from now on.
        scope: Name under which the fleet's robots are leased.
        descriptions: Descriptions of the robots to be commanded, by robot.
        patient: Whether to wait for an owner that may no longer renew its leases.
        on_wait: Callback that receives, once per lease, the lease that is being waited for.

    Returns:
        The acquired leases; enter the context to keep them renewed.

    Raises:
        LeaseHeldError: Another orchestrator owns one of the robots; the error holds its id and the
            remaining time.
        RobotOwnedError: A living orchestrator owns one of the robots, although it uses another
            repository or its lease has expired.
        NoReplyError: A robot does not answer.
    """
    check_others(fleet, descriptions, store.last(scope))
    waited = False

    def noted(held: LeaseHeldError) -> None:
        nonlocal waited
        waited = True
        on_wait(held)

    leases = hold_leases(
        store,
        scope,
        descriptions,
        owner=fleet.orchestrator_id,
        above_epochs={robot: found.epoch for robot, found in descriptions.items()},
        patient=patient,
        on_wait=noted,
    )
    if waited:
        # An orchestrator with another repository is not held up by these leases, so it may have
        # taken a robot during the wait.
        try:
            check_others(fleet, fleet.describe_all(tuple(descriptions)), store.last(scope))
        except NufleetError:
            leases.give_back()
            raise
    fleet.hold(leases.epochs)
    return leases


def check_others(
    fleet: Fleet, descriptions: Mapping[str, Description], given: Mapping[str, LastLease]
) -> None:
    """Check that no robot has a living owner besides the one in this repository's valid leases.

    Args:
        fleet: Client of the fleet, used to find out which owners are alive.
        descriptions: Description of each robot, which includes its last owner and epoch.
        given: Last lease that this repository granted, by robot.

    Raises:
        RobotOwnedError: A robot has such an owner; the message names it.
    """
    is_alive = functools.cache(fleet.is_alive)
    for robot, found in descriptions.items():
        ours = given.get(robot)
        suspects: dict[str, str] = {}
        if found.owner is not None and (
            ours is None or (found.owner, found.epoch) != (ours.owner, ours.epoch)
        ):
            suspects[found.owner] = (
                f"commanded by {found.owner} (epoch {found.epoch}), which uses another repository; "
                "wait until it has ended, or share one repository with --repository"
            )
        if ours is not None and ours.silent:
            suspects[ours.owner] = (
                f"owned by {ours.owner} (epoch {ours.epoch}), which is alive although its lease "
                "has expired; wait until it has ended or renewed the lease, or end it"
            )
        for owner, why in suspects.items():
            if owner != fleet.orchestrator_id and is_alive(owner):
                raise RobotOwnedError(f"robot {robot} is {why}")
