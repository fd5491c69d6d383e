"""The messages with which the simulated vehicle tells its state."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, Protocol

from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.shared.arrays import FloatArray

MODES = {
    "px4": {
        "offboard": 6 << 16,
        "position": 3 << 16,
        "hold": 4 << 16 | 3 << 24,
        "take-off": 4 << 16 | 2 << 24,
        "return": 4 << 16 | 5 << 24,
        "land": 4 << 16 | 6 << 24,
    },
    "ardupilot": {"guided": 4, "stabilize": 0, "loiter": 5, "return": 6, "land": 9},
}
"""Modes that it knows, by its autopilot."""


class ReportedState(Protocol):
    """The state of a vehicle, as it reports it."""

    mode: str
    """Name of its mode."""
    armed: bool
    """Whether its motors are armed."""
    in_air: bool
    """Whether it is off the ground."""
    charge: float
    """Charge of its battery, from 0 to 1."""
    estimates: bool
    """Whether it has a position estimate."""

    @property
    def profile(self) -> str:
        """Autopilot that it plays."""

    def measured(self) -> tuple[float, FloatArray, FloatArray]:
        """Return its clock in s, and position and velocity in NED in m and m/s, shape (3,) each."""


def _heartbeat(vehicle: ReportedState) -> Any:
    px4 = vehicle.profile == "px4"
    return dialect.MAVLink_heartbeat_message(
        dialect.MAV_TYPE_QUADROTOR,
        dialect.MAV_AUTOPILOT_PX4 if px4 else dialect.MAV_AUTOPILOT_ARDUPILOTMEGA,
        1 | (128 if vehicle.armed else 0),
        MODES[vehicle.profile][vehicle.mode],
        dialect.MAV_STATE_ACTIVE if vehicle.in_air else dialect.MAV_STATE_STANDBY,
        3,
    )


def _sys_status(vehicle: ReportedState) -> Any:
    sensors = 1 | 2 | 4 | dialect.MAV_SYS_STATUS_PREARM_CHECK
    volts = round(1000 * (14.0 + 2.8 * vehicle.charge))
    return dialect.MAVLink_sys_status_message(
        *(sensors, sensors, sensors, 200, volts, -1, round(100 * vehicle.charge)),
        *(0, 0, 0, 0, 0, 0),
    )


def _battery_status(vehicle: ReportedState) -> Any:
    cell = round(1000 * (3.5 + 0.7 * vehicle.charge))
    return dialect.MAVLink_battery_status_message(
        *(0, 0, 0, 2500, [cell] * 4 + [0xFFFF] * 6, -1, -1, -1, round(100 * vehicle.charge))
    )


def _estimator_status(vehicle: ReportedState) -> Any:
    flags = 0b0001_0011_1111 if vehicle.estimates else 0b1000_0001
    if vehicle.profile == "ardupilot":
        return dialect.MAVLink_ekf_status_report_message(flags, 0.1, 0.1, 0.1, 0.1, 0.1)
    stamp = round(1e6 * vehicle.measured()[0])
    return dialect.MAVLink_estimator_status_message(stamp, flags, *(0.1,) * 8)


def _extended_sys_state(vehicle: ReportedState) -> Any:
    return dialect.MAVLink_extended_sys_state_message(0, 2 if vehicle.in_air else 1)


def _local_position_ned(vehicle: ReportedState) -> Any:
    clock_s, place, velocity = vehicle.measured()
    return dialect.MAVLink_local_position_ned_message(
        int(1e3 * clock_s), *place.tolist(), *velocity.tolist()
    )


def _odometry(vehicle: ReportedState) -> Any:
    clock_s, place, velocity = vehicle.measured()
    # The nose looks to the east, so that the body's frame is turned against NED by 90°.
    forward, right, down = velocity[1], -velocity[0], velocity[2]
    turned = [math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)]
    return dialect.MAVLink_odometry_message(
        round(1e6 * clock_s),
        *(dialect.MAV_FRAME_LOCAL_NED, dialect.MAV_FRAME_BODY_FRD),
        *place.tolist(),
        turned,
        *(forward, right, down, 0.0, 0.0, 0.0),
        *([math.nan] * 21, [math.nan] * 21),
    )


POSITIONS = {dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED, dialect.MAVLINK_MSG_ID_ODOMETRY}
"""Numbers of the messages that hold a measured position."""

MESSAGES: dict[int, Callable[[ReportedState], Any]] = {
    dialect.MAVLINK_MSG_ID_HEARTBEAT: _heartbeat,
    dialect.MAVLINK_MSG_ID_SYS_STATUS: _sys_status,
    dialect.MAVLINK_MSG_ID_BATTERY_STATUS: _battery_status,
    dialect.MAVLINK_MSG_ID_ESTIMATOR_STATUS: _estimator_status,
    dialect.MAVLINK_MSG_ID_EKF_STATUS_REPORT: _estimator_status,
    dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: _extended_sys_state,
    dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: _local_position_ned,
    dialect.MAVLINK_MSG_ID_ODOMETRY: _odometry,
}
"""What builds each message that can be asked for, by its number."""
