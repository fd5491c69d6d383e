"""Leases on robots: taken before a study, renewed while it runs, released at its end."""

from __future__ import annotations

import functools
import logging
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from types import TracebackType
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
"""So long a lease outlives its owner, and so long may a database be away during a study."""

RENEW_EVERY_S = 2.0
_LOOK_EVERY_S = 0.2

_log = logging.getLogger(__name__)


class HeldLeases:
    """Renews leases in a thread of its own for as long as it is entered, then releases them.

    When one is lost the robots are somebody else's, and what moves them is interrupted.
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

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._released.set()
        self._thread.join()
        self.give_back()

    def give_back(self) -> None:
        """Release the leases; done by the exit of the context, where it was entered."""
        try:
            self._store.release(self._leases)
        except RepositoryError as problem:
            _log.warning("others have to wait until the leases have run out: %s", problem)

    @contextmanager
    def guarding(self, interrupt: Callable[[], None]) -> Iterator[None]:
        """Have what moves robots interrupted once a lease is lost, and raise why.

        Args:
            interrupt: ends what runs with `Interrupted`; called from another thread.

        Raises:
            LeaseLostError: another orchestrator has taken a robot over.
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
                _log.warning("leases are not renewed yet: %s", error)
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
    """Take robots for this orchestrator; enter what is returned.

    Args:
        store: the repository's leases.
        fleet: the robots'.
        robots: who is to be commanded.
        owner: this orchestrator's id.
        above_epochs: per robot, the latest epoch that it has seen.
        patient: whether to wait for an owner that renews nothing any more; one that does is alive.
            After the clock was set back there is always a wait, since nothing else tells them
            apart.
        on_wait: is told once for whom.

    Raises:
        LeaseHeldError: another orchestrator owns one of them; it says who and for how long.
    """
    names = tuple(robots)
    # Since when each lease of others has not been renewed, by a clock that nobody sets.
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
                    raise  # it was renewed: its owner lives
        time.sleep(_LOOK_EVERY_S)


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
        # Who keeps another repository knew nothing of the wait, and may have taken one meanwhile.
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
    """Check that no robot has a living owner that this repository's leases say nothing of.

    Args:
        fleet: asked who is alive.
        descriptions: what each robot says of itself, its last owner and epoch among it.
        given: the lease that this repository gave out last, by robot.

    Raises:
        RobotOwnedError: one has; it says who.
    """
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
