"""Why a vehicle that answers and obeys may still not begin a motion: its estimator, its battery."""

from __future__ import annotations

from nufleet.robot_agent.drivers.mavlink.profiles import (
    ESTIMATOR_ATTITUDE,
    ESTIMATOR_GUESSES,
    ESTIMATOR_POSITION,
)
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.robot_agent.drivers.mavlink.telemetry import Telemetry

CHARGE_OLD_S = 10.0
"""Age from which a charge, sent once a second, says nothing about the battery any more."""


def present_charge(telemetry: Telemetry, now_s: float) -> float | None:
    """Return the charge of the battery, 0 to 1; None if it is unknown or old."""
    return None if now_s - telemetry.charged_s > CHARGE_OLD_S else telemetry.charge


def weakness(telemetry: Telemetry, settings: MavlinkSettings, now_s: float) -> str:
    """Return what is wrong with the estimator or the battery; nothing if all is well."""
    flags, charge = telemetry.estimator, telemetry.charge
    if flags is not None:
        guesses = flags & ESTIMATOR_GUESSES or not flags & ESTIMATOR_POSITION
        if guesses or not flags & ESTIMATOR_ATTITUDE:
            what = "position" if flags & ESTIMATOR_ATTITUDE else "attitude"
            return f"its estimator has no {what} (flags {flags:#x}){telemetry.words(now_s)}"
    if charge is not None and present_charge(telemetry, now_s) is None:
        return (
            f"the charge of its battery has not arrived for {now_s - telemetry.charged_s:.0f} s: "
            "check its battery monitor"
        )
    if charge is not None and charge < settings.battery_min:
        volts = "" if telemetry.voltage_v is None else f" ({telemetry.voltage_v:.2f} V)"
        return (
            f"its battery is at {100 * charge:.0f} %{volts}, and {100 * settings.battery_min:g}"
            " % are needed: charge it"
        )
    return ""
