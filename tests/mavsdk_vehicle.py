"""MAVSDK's own vehicle side as a vehicle: an implementation of MAVLink that is not ours.

Its action server arms and changes modes. It has no dynamics, so that the vehicle is always where it
was told to be.
"""

from __future__ import annotations

import json
import threading
import time
from typing import Any

from mavsdk.component_type import ComponentType
from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.plugins.action_server.action_server import ActionServer, AllowableFlightModes
from mavsdk.plugins.mavlink_direct_server.mavlink_direct_server import (
    MavlinkDirectServer,
    MavlinkMessage,
)
from mavsdk.plugins.telemetry_server.telemetry_server import TelemetryServer

BOOTED_S = 1000.0
"""What its clock shows more than ours."""


class MavsdkVehicle:
    """Sends to a port as system 1, until it is closed."""

    def __init__(self, port: int) -> None:
        configuration = Configuration.create_with_component_type(ComponentType.AUTOPILOT)
        self._mavsdk = Mavsdk(configuration)
        self.set_points: list[dict[str, float]] = []
        """Set-points that MAVSDK decoded."""
        self.armed_as: list[tuple[bool, bool]] = []
        """Arming and disarming: whether to arm, and whether with force."""
        component = self._mavsdk.server_component()
        self._actions = ActionServer(component)
        self._actions.set_armable(True, True)
        self._actions.set_disarmable(True, True)
        self._actions.set_allowable_flight_modes(AllowableFlightModes(True, True, True))
        self._actions.subscribe_arm_disarm(
            lambda _, asked, *more: self.armed_as.append((bool(asked.arm), bool(asked.force)))
        )
        self._telemetry = TelemetryServer(component)  # answers SET_MESSAGE_INTERVAL
        self._direct = MavlinkDirectServer(component)
        self._direct.subscribe_message("TIMESYNC", self._answer)
        self._direct.subscribe_message("SET_POSITION_TARGET_LOCAL_NED", self._follow)
        assert self._mavsdk.add_any_connection(f"udpout://127.0.0.1:{port}") == 0
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._tell, daemon=True)
        self._thread.start()

    def close(self) -> None:
        self._ended.set()
        self._thread.join()
        self._mavsdk.destroy()

    def _send(self, name: str, **fields: Any) -> None:
        self._direct.send_message(MavlinkMessage(name, 1, 1, 0, 0, json.dumps(fields)))

    def _tell(self) -> None:
        while not self._ended.wait(0.02):
            last = self.set_points[-1] if self.set_points else {"x": 0.0, "y": 0.0, "z": 0.0}
            clock_ms = round(1e3 * (time.monotonic() + BOOTED_S))
            place = {name: last[name] for name in ("x", "y", "z")}
            still = {"vx": 0.0, "vy": 0.0, "vz": 0.0}
            self._send("LOCAL_POSITION_NED", time_boot_ms=clock_ms, **place, **still)

    def _answer(self, message: MavlinkMessage, _: object) -> None:
        asked = json.loads(message.fields_json)
        if int(asked["tc1"]) == 0:
            clock_ns = round(1e9 * (time.monotonic() + BOOTED_S))
            self._send("TIMESYNC", tc1=clock_ns, ts1=int(asked["ts1"]))

    def _follow(self, message: MavlinkMessage, _: object) -> None:
        self.set_points.append(json.loads(message.fields_json))
