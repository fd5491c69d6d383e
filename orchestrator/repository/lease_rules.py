"""Who owns a robot, as pure functions over a stored lease and the database's time.

The time decides only when a silent owner may be replaced. That the replaced one can do no harm
rests on the epoch, which never falls: robots and trials refuse a lower one.
"""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.repository.errors import LeaseHeldError, LeaseLostError
from orchestrator.repository.records import Lease


@dataclass(frozen=True)
class StoredLease:
    """The row of a robot; `owner` is None when it was released or never owned."""

    fleet: str
    robot: str
    owner: str | None
    epoch: int
    term_s: float
    expires_s: float

    def remaining_s(self, now_s: float) -> float:
        """Return for how long it holds still; 0 when nobody holds it."""
        left_s = self.expires_s - now_s
        # More than a whole term can only be left when the clock was set back: it means nothing.
        return 0.0 if self.owner is None or left_s > self.term_s else max(0.0, left_s)


def acquired(
    stored: StoredLease, *, owner: str, term_s: float, above_epoch: int, now_s: float
) -> Lease:
    """Return the lease that an owner gets; raises LeaseHeldError while another holds it.

    Args:
        stored: what is known of the robot.
        owner: who asks; who holds it already gets the same epoch again.
        term_s: how long it holds without being renewed.
        above_epoch: the latest epoch that the robot has seen, perhaps from another repository.
        now_s: the database's time.
    """
    remaining_s = stored.remaining_s(now_s)
    epoch = max(stored.epoch, above_epoch) + 1
    if remaining_s > 0.0 and stored.owner is not None:
        if stored.owner != owner:
            raise LeaseHeldError(stored.robot, stored.owner, stored.epoch, remaining_s)
        if stored.epoch >= above_epoch:
            epoch = stored.epoch
    return Lease(stored.fleet, stored.robot, owner, epoch, term_s)


def check_held(stored: StoredLease, lease: Lease, now_s: float) -> None:
    """Check that a lease holds still; raises LeaseLostError with the reason."""
    reason = None
    if (stored.owner, stored.epoch) != (lease.owner, lease.epoch):
        reason = f"{stored.owner or 'nobody'} owns it under epoch {stored.epoch}"
    elif stored.remaining_s(now_s) == 0.0:
        reason = f"it was not renewed for {lease.term_s:g} s"
    if reason is not None:
        raise LeaseLostError(lease.robot, lease.owner, lease.epoch, reason)
