"""Set-points: where a vehicle shall be, and how fast, as the message that says so."""

from __future__ import annotations

from typing import Any

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.frames import ned_of_enu, yaw_of_other_frame
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.shared.arrays import FloatArray

USED = 0b1001_1100_0000
"""Type mask of a set-point of position, velocity and yaw: acceleration and yaw rate are unused."""

VELOCITY_UNUSED = 0b0000_0011_1000
"""Further bits for a set-point without velocity."""


class SetPoints:
    """Makes the set-points of one vehicle."""

    def __init__(self, settings: MavlinkSettings) -> None:
        self._settings = settings
        self.yaw_rad: float | None = None
        """Direction of the nose, anticlockwise from the east; None for as it stands."""

    def at(self, place: FloatArray, velocity: FloatArray, now_s: float) -> Any:
        """Return the message with a set-point.

        Args:
            place: Position (east, north, up) in the vehicle's local frame in m, shape (3,).
            velocity: Its derivative in m/s, shape (3,).
            now_s: The time, by which the vehicle tells which of two set-points is newer.
        """
        settings = self._settings
        mask = USED if settings.feed_forward else USED | VELOCITY_UNUSED
        yaw = 0.0
        if self.yaw_rad is None:
            mask |= dialect.POSITION_TARGET_TYPEMASK_YAW_IGNORE
        else:
            yaw = yaw_of_other_frame(self.yaw_rad)
        return dialect.MAVLink_set_position_target_local_ned_message(
            int(1e3 * now_s) & 0xFFFF_FFFF,
            settings.system_id,
            settings.component_id,
            dialect.MAV_FRAME_LOCAL_NED,
            mask,
            *np.concatenate([ned_of_enu(place), ned_of_enu(velocity)]).tolist(),
            *(0.0, 0.0, 0.0, yaw, 0.0),
        )
