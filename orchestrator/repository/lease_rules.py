"""Who owns a robot, as pure functions over a stored lease and the database's time.

That somebody who was replaced can do no harm rests on the epoch, which never falls: robots and
trials refuse a lower one. Time decides only when a silent owner may be replaced, and the database's
clock is a wall clock, which may be set at any moment:

- An owner keeps its lease as long as nobody else has taken it, whatever the clock says: it renews
  what is still stored under its name and epoch, and thereby brings it to the clock as it is now.
- Another may take a lease that its owner released, or did not renew for a whole term by the clock.
  When the clock is set forward, leases of living owners look like that until their next renewal;
  before one is taken, the network is asked whether its owner lives
  (`nufleet.orchestrator.conduct.leases`).
- A lease that would hold for longer than a term was renewed before the clock was set back, and
  nobody knows when. It holds for another term, measured by those who wait for it: an owner whose
  `Renewal` they saw unchanged for that long is silent.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

from nufleet.orchestrator.repository.errors import (
    EpochOutOfRangeError,
    LeaseHeldError,
    LeaseLostError,
)
from nufleet.orchestrator.repository.records import Lease, Renewal
from nufleet.shared.wire.messages import EPOCH_MAX

EPOCH_BELIEVED_MAX = EPOCH_MAX // 2
"""A robot that saw a higher one was told nonsense; believed, it would leave no room above it."""

RELEASED_S = 0.0
"""The time at which a lease that was given back ran out."""

_CLOCK_S = 0.1
"""A difference that no clock was set by: rounding, and ticks of a millisecond."""


@dataclass(frozen=True)
class StoredLease:
    """The row of a robot; `owner` is who had it last, None when nobody ever did."""

    fleet: str
    robot: str
    owner: str | None
    epoch: int
    term_s: float
    expires_s: float

    @property
    def released(self) -> bool:
        """Whether nobody has it, by its last owner's own word."""
        return self.owner is None or self.expires_s == RELEASED_S

    def remaining_s(self, now_s: float) -> float:
        """Return for how long it holds still, which is a term at most; 0 when nobody holds it."""
        return 0.0 if self.released else min(self.term_s, max(0.0, self.expires_s - now_s))

    def renewal(self, now_s: float) -> Renewal | None:
        """Return its latest renewal; None when nobody holds it."""
        if self.owner is None or self.remaining_s(now_s) == 0.0:
            return None
        set_back = self.expires_s - now_s > self.term_s + _CLOCK_S
        return Renewal(
            self.robot,
            self.owner,
            self.epoch,
            self.term_s,
            self.expires_s,
            before_set_back=set_back,
        )


def acquired(
    stored: StoredLease,
    *,
    owner: str,
    term_s: float,
    above_epoch: int,
    now_s: float,
    silent: Collection[Renewal] = (),
) -> Lease:
    """Return the lease that an owner gets.

    Args:
        stored: what is known of the robot.
        owner: who asks; who holds it already gets the same epoch again.
        term_s: how long it holds without being renewed.
        above_epoch: the latest epoch that the robot has seen, perhaps from another repository.
        now_s: the database's time.
        silent: renewals that the owner who asks saw unchanged for a whole term of its own clock.

    Raises:
        LeaseHeldError: another holds it.
        EpochOutOfRangeError: the robot was told an epoch that no repository gives out, or this one
            has none left.
    """
    held = stored.renewal(now_s)
    if above_epoch > EPOCH_BELIEVED_MAX:
        raise EpochOutOfRangeError(
            f"robot {stored.robot} was commanded under epoch {above_epoch}, which no repository "
            "gives out; find out who sent it, end the robot's agent, and make the robot forget its "
            f"owner: nufleet agent FLEET --robot {stored.robot} --forget-owner"
        )
    epoch = max(stored.epoch, above_epoch) + 1
    if epoch > EPOCH_MAX:
        raise EpochOutOfRangeError(
            f"this repository gave robot {stored.robot} out under epoch {stored.epoch}, and none "
            "above it is obeyed; begin another with --repository"
        )
    if held is not None and held not in silent:
        if held.owner != owner:
            raise LeaseHeldError([held], stored.remaining_s(now_s))
        if stored.epoch >= above_epoch:
            epoch = stored.epoch
    return Lease(stored.fleet, stored.robot, owner, epoch, term_s)


def check_held(stored: StoredLease, lease: Lease) -> None:
    """Check that nobody has taken a lease over; raises LeaseLostError with the reason."""
    reason = None
    if (stored.owner, stored.epoch) != (lease.owner, lease.epoch):
        reason = f"{stored.owner or 'nobody'} owns it under epoch {stored.epoch}"
    elif stored.released:
        reason = "it was released"
    if reason is not None:
        raise LeaseLostError(lease.robot, lease.owner, lease.epoch, reason)
