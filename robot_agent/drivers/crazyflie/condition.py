"""Decides from what a Crazyflie logs whether it can move, and for how long."""

from __future__ import annotations

import math

from nufleet.robot_agent.drivers.crazyflie.settings import Battery, CrazyflieSettings
from nufleet.robot_agent.drivers.crazyflie.telemetry import (
    LOST_M2,
    STATUS_PERIOD_S,
    Measurement,
    Telemetry,
)
from nufleet.shared.robots.health import Health

SILENT_MAX_S = 1.0
"""Time without a status after which the drone counts as silent."""

YAW_MAX_RAD = math.radians(30.0)
"""Angle between its front and the x axis beyond which it does not take off: every set-point turns
it to yaw 0, at once."""


def condition(
    settings: CrazyflieSettings,
    telemetry: Telemetry,
    down: str | None,
    blind: str | None,
    now_s: float,
) -> Health:
    """Return the condition of a drone.

    Args:
        settings: Settings of the drone.
        telemetry: What it has logged.
        down: Reason why the drone no longer responds to commands; None while it does.
        blind: Why motion capture does not see it; None if it does, or is not used.
        now_s: The time on the monotonic clock of this machine.
    """
    status = telemetry.status
    why = down or telemetry.fault
    if why is None and (status is None or now_s - status.arrived_s > SILENT_MAX_S):
        silent_s = "" if status is None else f" for {now_s - status.arrived_s:.1f} s"
        why = f"it has sent nothing{silent_s}, but a status is due every {STATUS_PERIOD_S:g} s"
    why = why or blind
    if status is None:
        return Health(ready=False, reason=why or "it has sent nothing yet")
    charge = charge_of(settings.battery, status.battery_v)
    if why is None and not status.battery_v >= settings.battery.empty_v:
        why = (
            f"its battery is empty: {status.battery_v:.2f} V, below {settings.battery.empty_v:g} V "
            "(battery.empty_v); charge it"
        )
    if why is None and not status.variance_m2 <= LOST_M2 and settings.estimator != "complementary":
        why = (
            f"it does not know its position: the variance is {status.variance_m2:.2g} m². Can "
            "it see its base stations, or can the motion capture system see it?"
        )
    reserve = settings.battery.reserve
    return Health(
        ready=why is None,
        reason=why or "",
        battery=charge,
        endurance_s=max(0.0, charge - reserve) * settings.battery.flight_time_s,
        link=telemetry.arriving,
    )


def misplaced(settings: CrazyflieSettings, stands: Measurement) -> str | None:
    """Return why a drone does not take off from where it stands; None if it may."""
    x_m, y_m, z_m = stands.position_m.tolist()
    origin_x_m, origin_y_m, origin_z_m = settings.origin_m
    away_m = math.hypot(x_m - origin_x_m, y_m - origin_y_m)
    if away_m > settings.start_within_m:
        return (
            f"stands at ({x_m:.2f}, {y_m:.2f}) m, {away_m:.2f} m from its origin "
            f"({origin_x_m:g}, {origin_y_m:g}) m; at most {settings.start_within_m:g} m are "
            "allowed (start_within_m): carry it there, or correct origin_m"
        )
    above_m, (lower_m, setting) = origin_z_m - z_m, settings.lowest
    if above_m <= lower_m:
        return (
            f"stands at a height of {z_m:.2f} m, and its origin is {above_m:.2f} m above that; a "
            f"motion may lead {lower_m:g} m lower ({setting}): raise origin_m, or check the frame"
        )
    if abs(stands.yaw_rad) > YAW_MAX_RAD:
        return (
            f"is turned by {math.degrees(stands.yaw_rad):.0f} degrees; at most "
            f"{math.degrees(YAW_MAX_RAD):.0f} are allowed: set it down with its front along the x "
            "axis"
        )
    return None


def charge_of(battery: Battery, voltage_v: float) -> float:
    """Return the charge that a voltage stands for, by a straight line: 0 if empty, 1 if full."""
    return min(1.0, max(0.0, (voltage_v - battery.empty_v) / (battery.full_v - battery.empty_v)))
