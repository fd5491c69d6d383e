"""What a robot reports of itself while it works: whether it can move, its battery and its link."""

from __future__ import annotations

from pydantic import model_validator

from nufleet.shared.strict import Fraction, NonNegative, Reason, Strict


class Health(Strict):
    """A robot's present condition, as far as its driver knows it.

    Examples:
        >>> Health(battery=0.64, endurance_s=210.0).ready
        True
    """

    ready: bool = True
    """Whether it can move now: it has a position estimate, is not locked, and so on."""
    reason: Reason = ""
    """Why it cannot, for people; empty for a robot that is ready."""
    battery: Fraction | None = None
    """Charge that is left; None if unknown."""
    endurance_s: NonNegative | None = None
    """Time for which it can still move and keep what it needs to come back and land; None if
    unknown."""
    link: Fraction | None = None
    """Share of the packets between driver and robot that arrive; None if unknown."""

    @model_validator(mode="after")
    def _explained(self) -> Health:
        if self.ready == bool(self.reason):
            raise ValueError("a robot that is not ready has a reason, and only such a robot has")
        return self
