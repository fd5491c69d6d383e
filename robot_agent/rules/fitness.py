"""Decides from a robot's reported health whether it may move, and for how long. Pure."""

from __future__ import annotations

from nufleet.shared.robots.health import Health
from nufleet.shared.wire.messages import Refusal

HEALTH_INTERVAL_S = 0.5
"""Interval at which a driver is asked for the robot's health."""

HEALTH_MAX_AGE_S = 3.0
"""Age from which the last health no longer tells whether the robot may move."""


def unfit(health: Health | None, age_s: float) -> str | None:
    """Return why a robot may not move; None when it may, and for one that reports no health.

    Args:
        health: Health that was reported last; None for a robot that reports none.
        age_s: Time since then in s.
    """
    if health is None:
        return None
    if age_s > HEALTH_MAX_AGE_S:
        return f"its driver has not reported its health for {age_s:.1f} s"
    return None if health.ready else health.reason


def refusal_to_last(health: Health | None, duration_s: float) -> Refusal | None:
    """Return why a motion of this duration would end with an empty battery; None when it fits.

    Args:
        health: Health that was reported last; None for a robot that reports none.
        duration_s: Duration of the motion in s.
    """
    if health is None or health.endurance_s is None or duration_s <= health.endurance_s:
        return None
    charge = "" if health.battery is None else f" (charged to {health.battery:.0%})"
    return Refusal(
        code="battery",
        reason=f"the motion takes {duration_s:.4g} s, and the battery{charge} lasts for "
        f"{health.endurance_s:.4g} s of motion; charge it, or ask for a shorter motion",
    )
