"""What a vehicle has to be, and to send, before the driver asks it to move."""

from __future__ import annotations

from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.profiles import (
    ARDUPILOT_AUTOPILOT,
    PX4_AUTOPILOT,
    Profile,
)
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.robot_agent.drivers.mavlink.telemetry import Heartbeat
from nufleet.shared.errors import RobotError

TAKES_NO_HOLD = {1: "a fixed-wing aircraft", 10: "a ground vehicle", 11: "a boat", 12: "submarine"}
"""Values of MAV_TYPE that cannot hover at reference 0."""


def check_kind(heartbeat: Heartbeat, profile: Profile, settings: MavlinkSettings) -> None:
    """Check that a vehicle runs the autopilot of the fleet file, and can hover.

    Raises:
        RobotError: It does not, or cannot.
    """
    known = {PX4_AUTOPILOT: "PX4", ARDUPILOT_AUTOPILOT: "ArduPilot"}
    found = known.get(heartbeat.autopilot)
    if found is not None and found != profile.name:
        raise RobotError(
            f"system {settings.system_id} runs {found}, and the fleet file says "
            f"profile = {settings.profile!r}"
        )
    if heartbeat.vehicle_type in TAKES_NO_HOLD:
        raise RobotError(
            f"system {settings.system_id} is {TAKES_NO_HOLD[heartbeat.vehicle_type]}, "
            "which cannot hover at reference 0"
        )


def helpful_messages(profile: Profile) -> dict[int, float]:
    """Return the rates in Hz of messages that help and are not needed, by their numbers."""
    estimator = (
        dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS
        if profile.autopilot == PX4_AUTOPILOT
        else dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT
    )
    return {
        dialect.MAVLINK_MSG_ID_HEARTBEAT: 5.0,
        dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 5.0,
        dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
        dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
        estimator: 2.0,
    }
