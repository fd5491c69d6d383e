"""The rules of robot ownership, as pure functions of a stored lease and the database's time.

A replaced owner can do no harm because the epoch never decreases: robots and trials refuse a lower
one. Time only decides when a silent owner may be replaced, and the database's clock is a wall
clock, which may be set at any moment:

- An owner keeps its lease until another one has taken it, regardless of the clock: it renews the
  lease that is still stored under its name and epoch, and thereby adapts it to the current clock.
- Another may take a lease that its owner released, or did not renew for a whole term by the clock.
  When the clock is set forward, leases of living owners look like that until their next renewal;
  before one is taken, the network is asked whether its owner lives
  (`nufleet.orchestrator.conduct.leases`).
- A lease that would hold for longer than a term was renewed before the clock was set back, at an
  unknown time. It holds for another term, measured by the waiting orchestrators: an owner whose
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
"""Highest plausible epoch; accepting a higher one from a robot would leave no epochs above it."""

RELEASED_S = 0.0
"""Expiry time in s that marks a released lease."""

_CLOCK_S = 0.1
"""Difference in s that is due to rounding and millisecond ticks rather than to a set clock."""


@dataclass(frozen=True)
class StoredLease:
    """A robot's lease as it is stored."""

    fleet: str
    """Name under which the robot's fleet is leased."""
    robot: str
    """Name of the robot."""
    owner: str | None
    """Id of the last owner; None if the robot was never owned."""
    epoch: int
    """Epoch of the last lease."""
    term_s: float
    """Time in s for which the lease holds without being renewed."""
    expires_s: float
    """Time at which the lease expires, in s on the database's clock."""

    @property
    def released(self) -> bool:
        """Whether the last owner released the robot, or there never was one."""
        return self.owner is None or self.expires_s == RELEASED_S

    def remaining_s(self, now_s: float) -> float:
        """Return the remaining time in s, at most one term; 0 when the robot is not owned."""
        return 0.0 if self.released else min(self.term_s, max(0.0, self.expires_s - now_s))

    def renewal(self, now_s: float) -> Renewal | None:
        """Return the latest renewal; None when the robot is not owned."""
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
    """Return the lease that is granted to an owner.

    Args:
        stored: Stored lease of the robot.
        owner: Id of the requesting owner; the present owner gets the same epoch again.
        term_s: Time in s for which the lease holds without being renewed.
        above_epoch: Latest epoch that the robot has seen, possibly from another repository.
        now_s: Current time in s on the database's clock.
        silent: Renewals that the requesting owner saw unchanged for a whole term of its own clock.

    Raises:
        LeaseHeldError: Another orchestrator owns the robot.
        EpochOutOfRangeError: The robot has seen an epoch that no repository grants, or this
            repository has no epoch left.
    """
    held = stored.renewal(now_s)
    if above_epoch > EPOCH_BELIEVED_MAX:
        raise EpochOutOfRangeError(
            f"robot {stored.robot} was commanded under epoch {above_epoch}, which no repository "
            "issues; find out which orchestrator sent it, end the robot's agent, and make the "
            f"robot forget its owner: nufleet agent FLEET --robot {stored.robot} --forget-owner"
        )
    epoch = max(stored.epoch, above_epoch) + 1
    if epoch > EPOCH_MAX:
        raise EpochOutOfRangeError(
            f"this repository issued epoch {stored.epoch} for robot {stored.robot}, and robots "
            "accept none above it; start a new repository with --repository"
        )
    if held is not None and held not in silent:
        if held.owner != owner:
            raise LeaseHeldError([held], stored.remaining_s(now_s))
        if stored.epoch >= above_epoch:
            epoch = stored.epoch
    return Lease(stored.fleet, stored.robot, owner, epoch, term_s)


def check_held(stored: StoredLease, lease: Lease) -> None:
    """Check that a lease has not been taken over; raises LeaseLostError with the reason."""
    reason = None
    if (stored.owner, stored.epoch) != (lease.owner, lease.epoch):
        reason = f"{stored.owner or 'no orchestrator'} owns it under epoch {stored.epoch}"
    elif stored.released:
        reason = "it was released"
    if reason is not None:
        raise LeaseLostError(lease.robot, lease.owner, lease.epoch, reason)
