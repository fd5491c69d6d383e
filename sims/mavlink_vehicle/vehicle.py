"""The simulated vehicle: what it does with messages, and what it sends as time passes.

Its clock is not ours. It keeps the rules of PX4 and of ArduPilot's Copter that a driver has to live
with: no offboard mode without a stream of set-points, a failsafe when that stream ends, and no
arming without a position.
"""

from __future__ import annotations

import heapq
import math
from collections import deque
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import Field
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Fraction, NonNegative, Positive, Strict
from nufleet.sims.mavlink_vehicle.loop import Loop, LoopSettings
from nufleet.sims.mavlink_vehicle.messages import MESSAGES, MODES, POSITIONS

TICK_S = 0.02
"""Time between two looks at its failsafes."""

SET_POINT_LOST_S = 1.0
"""Age of the last set-point that ends offboard mode (PX4's COM_OF_LOSS_T)."""

LANDS_M_S, FALLS_M_S2 = 0.7, 9.81
DISARMS_S = 0.5
"""Time on the ground after a landing until it disarms."""

GROUND_STATION_LOST_S = 5.0
"""Silence of the system that ArduPilot watches that ends guided mode (FS_GCS_TIMEOUT)."""

EMPTY = 0.1
"""Charge at which it returns by itself."""

FORCED = 21196.0
ACCEPTED, REJECTED, DENIED, UNSUPPORTED = 0, 1, 2, 3


class VehicleSettings(Strict):
    """One simulated vehicle."""

    profile: Literal["px4", "ardupilot"] = "px4"
    """Autopilot that it plays."""
    system_id: Annotated[int, Field(ge=1, le=255)] = 1
    """Its MAVLink system id."""
    loop: LoopSettings = LoopSettings()
    """Its position loop."""
    noise_std_m: NonNegative = 0.001
    """Standard deviation of its measured position."""
    stands_at_m: tuple[float, float] = (0.0, 0.0)
    """Where it stands at first, (east, north) in its local frame."""
    clock_s: NonNegative = 1234.5
    """What its clock shows when ours shows 0."""
    clock_drift: Annotated[float, Field(ge=-1e-3, le=1e-3)] = 2e-5
    """Relative error of its clock."""
    charge: Fraction = 0.9
    """Charge of its battery at first."""
    flight_time_s: Positive = 1200.0
    """Time in the air from a full battery to an empty one."""


class SimulatedVehicle:
    """One vehicle; faults are its attributes and may be set at any time."""

    def __init__(self, settings: VehicleSettings, rng: np.random.Generator, now_s: float) -> None:
        """Stand on the ground, disarmed.

        Args:
            settings: Settings of the vehicle.
            rng: Generator of its noise.
            now_s: Present time on our clock.
        """
        self._settings, self._rng = settings, rng
        self._ground = np.array([*settings.stands_at_m, 0.0])
        self.loop = Loop(settings.loop, self._ground)
        """Its position loop."""
        self.mode = "position" if settings.profile == "px4" else "stabilize"
        """Name of its mode."""
        self.armed = False
        self.in_air = False
        self.charge = settings.charge
        """Charge of its battery."""
        self.estimates = True
        """Whether it has a position estimate."""
        self.refuses: dict[int, str] = {}
        """Commands that it denies, and what it says about them."""
        ardupilot = settings.profile == "ardupilot"
        self.parameters = {"SYSID_MYGCS": 245.0, "FS_GCS_ENABLE": 5.0} if ardupilot else {}
        """Parameters that it tells, by name."""
        self.answers_timesync = True
        self.sends_position = True
        self.interval_min_s = 1e-3
        """Shortest time between two messages of a kind that its port has room for."""
        self.clock_jump_s = 0.0
        """What its clock has been set forward by."""
        self.set_points = 0
        """Number of set-points that arrived."""
        self.commands: list[int] = []
        """Commands that arrived."""
        self._set_point: tuple[float, FloatArray, FloatArray] | None = None
        self._stamp_ms = -1
        self._watched_s = math.inf
        self._arrivals: deque[float] = deque(maxlen=3)
        self._acting: deque[tuple[float, FloatArray, FloatArray]] = deque()
        self._aim = self._ground.copy()
        self._climbs_to: float | None = None
        self._landed_s = -1.0
        self._now_s = now_s
        self._said: list[Any] = []
        standard = {
            dialect.MAVLINK_MSG_ID_HEARTBEAT: 1.0,
            dialect.MAVLINK_MSG_ID_SYS_STATUS: 1.0,
            dialect.MAVLINK_MSG_ID_BATTERY_STATUS: 1.0,
            dialect.MAVLINK_MSG_ID_EXTENDED_SYS_STATE: 1.0,
            dialect.MAVLINK_MSG_ID_LOCAL_POSITION_NED: 4.0,
        }
        self._interval_s = {message: 1.0 / rate for message, rate in standard.items()}
        # Due times of messages, and of the tick, whose number is -1.
        self._due = [(now_s, -1), *((now_s, message) for message in standard)]
        heapq.heapify(self._due)

    @property
    def profile(self) -> str:
        """Autopilot that it plays."""
        return self._settings.profile

    @property
    def system_id(self) -> int:
        """Its MAVLink system id."""
        return self._settings.system_id

    @property
    def next_s(self) -> float:
        """Time at which it next does something by itself."""
        return self._due[0][0]

    @property
    def position(self) -> FloatArray:
        """Its true position (east, north, up), shape (3,)."""
        return self.loop.position.copy()

    def clock_s(self, now_s: float) -> float:
        """Return what its clock shows."""
        settings = self._settings
        return settings.clock_s + (1 + settings.clock_drift) * now_s + self.clock_jump_s

    def take_over(self, mode: str) -> None:
        """Have a pilot or a failsafe switch to another mode."""
        self.mode = mode
        self._aim = self.position

    def say(self, text: str, severity: int = 3) -> None:
        """Say something with its next messages."""
        self._said.append(dialect.MAVLink_statustext_message(severity, text.encode()))

    def advance(self, now_s: float) -> list[Any]:
        """Live until a time; return what it sends."""
        sent: list[Any] = []
        while self._due[0][0] <= now_s:
            due_s, what = heapq.heappop(self._due)
            self._move_to(due_s)
            if what < 0:
                self._tick()
                heapq.heappush(self._due, (due_s + TICK_S, what))
            elif what in self._interval_s:
                heapq.heappush(self._due, (due_s + self._interval_s[what], what))
                message = self._message(what)
                if message is not None:
                    sent.append(message)
        self._move_to(now_s)
        said, self._said = self._said, []
        return said + sent

    def receive(self, message: Any, now_s: float) -> list[Any]:
        """Take a message; return what it answers at once."""
        self._move_to(now_s)
        kind = message.get_type()
        if kind == "TIMESYNC" and not message.tc1 and self.answers_timesync:
            return [dialect.MAVLink_timesync_message(round(1e9 * self.clock_s(now_s)), message.ts1)]
        if kind == "HEARTBEAT" and message.get_srcSystem() == self.parameters.get("SYSID_MYGCS"):
            self._watched_s = now_s
        target = getattr(message, "target_system", self._settings.system_id)
        if target not in {0, self._settings.system_id}:
            return []
        if kind == "SET_POSITION_TARGET_LOCAL_NED":
            self._take_set_point(message, now_s)
        if kind == "PARAM_REQUEST_READ" and message.param_id in self.parameters:
            name = message.param_id
            return [
                dialect.MAVLink_param_value_message(name.encode(), self.parameters[name], 9, 2, 0)
            ]
        if kind == "COMMAND_LONG":
            self.commands.append(message.command)
            if message.command in self.refuses:
                self.say(self.refuses[message.command])
                result = DENIED
            else:
                result = self._obey(message)
            said, self._said = self._said, []
            answer = dialect.MAVLink_command_ack_message(
                message.command, result, 0, 0, message.get_srcSystem(), message.get_srcComponent()
            )
            return [*said, answer, *self._asked_for(message)]
        return []

    def _asked_for(self, message: Any) -> list[Any]:
        wanted = dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
        if message.command == dialect.MAV_CMD_REQUEST_MESSAGE and message.param1 == wanted:
            capabilities = (
                dialect.MAV_PROTOCOL_CAPABILITY_MAVLINK2
                | dialect.MAV_PROTOCOL_CAPABILITY_SET_POSITION_TARGET_LOCAL_NED
                | dialect.MAV_PROTOCOL_CAPABILITY_FLIGHT_TERMINATION
            )
            zero = bytes(8)
            return [
                dialect.MAVLink_autopilot_version_message(
                    capabilities, 0, 0, 0, 0, zero, zero, zero, 0, 0, self._settings.system_id
                )
            ]
        return []

    def _take_set_point(self, message: Any, now_s: float) -> None:
        self.set_points += 1
        self._arrivals.append(now_s)
        if message.time_boot_ms < self._stamp_ms:
            return  # a newer one has overtaken it
        self._stamp_ms = message.time_boot_ms
        mask = message.type_mask
        place = np.array([message.y, message.x, -message.z])
        velocity = np.array([message.vy, message.vx, -message.vz])
        if mask & 0b0000_0011_1000:
            velocity = np.zeros(3)
        self._set_point = (now_s, place, velocity)
        self._acting.append((now_s + self._settings.loop.delay_s, place, velocity))

    def _obey(self, message: Any) -> int:
        match message.command:
            case dialect.MAV_CMD_SET_MESSAGE_INTERVAL:
                return self._set_interval(int(message.param1), message.param2)
            case dialect.MAV_CMD_REQUEST_MESSAGE:
                known = message.param1 == dialect.MAVLINK_MSG_ID_AUTOPILOT_VERSION
                return ACCEPTED if known else UNSUPPORTED
            case dialect.MAV_CMD_DO_SET_MODE:
                return self._set_mode(message)
            case dialect.MAV_CMD_COMPONENT_ARM_DISARM:
                return self._arm(message.param1 > 0, forced=message.param2 == FORCED)
            case dialect.MAV_CMD_NAV_TAKEOFF:
                return self._take_off(message.param7)
            case dialect.MAV_CMD_NAV_LAND:
                self.take_over("land")
                return ACCEPTED
            case dialect.MAV_CMD_DO_FLIGHTTERMINATION:
                self.armed = False
                return ACCEPTED
        return UNSUPPORTED

    def _set_interval(self, message: int, interval_us: float) -> int:
        if message not in MESSAGES:
            return DENIED
        self._due = [(self._now_s, message), *(due for due in self._due if due[1] != message)]
        heapq.heapify(self._due)
        self._interval_s[message] = max(interval_us * 1e-6, self.interval_min_s)
        return ACCEPTED

    def _set_mode(self, message: Any) -> int:
        modes = MODES[self._settings.profile]
        if self._settings.profile == "px4":
            number = int(message.param2) << 16 | int(message.param3) << 24
        else:
            number = int(message.param2)
        mode = next((name for name, known in modes.items() if known == number), None)
        if mode is None:
            return DENIED
        if mode == "offboard" and (not self._streams or not self.estimates):
            self.say("Switching to offboard is not possible: no setpoint")
            return REJECTED
        if mode != self.mode:
            self.take_over(mode)
        return ACCEPTED

    @property
    def _streams(self) -> bool:
        arrivals = self._arrivals
        return len(arrivals) == arrivals.maxlen and self._now_s - arrivals[0] < SET_POINT_LOST_S

    def _arm(self, on: bool, *, forced: bool) -> int:
        if on and not self.estimates:
            self.say("Preflight Fail: no valid local position estimate")
            return REJECTED
        if not on and self.in_air and not forced:
            return DENIED
        self.armed = on
        if on:
            self._aim = self.position
        return ACCEPTED

    def _take_off(self, height_m: float) -> int:
        if not self.armed:
            return REJECTED
        if self._settings.profile == "px4":
            self.take_over("take-off")
            height_m = 2.5
        self._climbs_to = float(self._ground[2]) + height_m
        self._aim = self.position
        return ACCEPTED

    def _watch(self) -> None:
        """Act on its failsafes."""
        obeys = self.mode in {"offboard", "guided"}
        last_s = self._set_point[0] if self._set_point else -math.inf
        if self.armed and self.mode == "offboard" and self._now_s - last_s > SET_POINT_LOST_S:
            self.say("Failsafe activated: offboard control lost, landing")
            self.take_over("land")
        silent_s = self._now_s - self._watched_s
        acts = bool(self.parameters.get("FS_GCS_ENABLE"))
        if self.armed and self.mode == "guided" and acts and silent_s > GROUND_STATION_LOST_S:
            self.say("GCS Failsafe")
            self.take_over("land")
        if self.in_air and obeys and self.charge < EMPTY:
            self.say("Low battery: returning to launch")
            self.take_over("return")

    def _tick(self) -> None:
        if self.in_air:
            self.charge = max(0.0, self.charge - TICK_S / self._settings.flight_time_s)
        self._watch()
        if not self.armed:
            self._fall()
            return
        if self._climbs_to is not None:
            self.in_air = True
            up = min(self._climbs_to, self._aim[2] + LANDS_M_S * TICK_S)
            self._aim = np.array([*self._aim[:2], up])
            if up == self._climbs_to and abs(self.loop.position[2] - up) < 0.02:
                self._climbs_to = None
        elif self.mode in {"land", "return"}:
            self._aim = self._aim - np.array([0.0, 0.0, LANDS_M_S * TICK_S])
        elif self.mode in {"offboard", "guided"} and self._set_point is not None:
            if self._set_point[1][2] > self._ground[2] + 0.01:
                self.in_air = True
            return
        self.loop.aim(self._aim, np.zeros(3))
        self._land()

    def _land(self) -> None:
        if self.mode not in {"land", "return"}:
            return
        if self.loop.position[2] <= self._ground[2] + 0.02:
            self._ground[:2] = self.loop.position[:2]
            self.loop.put(self._ground)
            if self.in_air or self._landed_s < 0:
                self.in_air, self._landed_s = False, self._now_s
        if not self.in_air and self._now_s - self._landed_s > DISARMS_S:
            self.armed, self._landed_s = False, -1.0

    def _fall(self) -> None:
        if self.in_air:
            velocity = self.loop.velocity - np.array([0.0, 0.0, FALLS_M_S2 * TICK_S])
            place = self.loop.position + velocity * TICK_S
            self.in_air = bool(place[2] > self._ground[2])
            self.loop.put(place if self.in_air else np.array([*place[:2], self._ground[2]]))
            self.loop.velocity = velocity if self.in_air else np.zeros(3)

    def _move_to(self, now_s: float) -> None:
        """Move the loop on, with every set-point that begins to act on the way."""
        while self._acting and self._acting[0][0] <= now_s:
            at_s, place, velocity = self._acting.popleft()
            self._loop_to(at_s)
            if self.armed and self._climbs_to is None and self.mode in {"offboard", "guided"}:
                self.loop.aim(place, velocity)
        self._loop_to(now_s)

    def _loop_to(self, now_s: float) -> None:
        if now_s > self._now_s:
            if self.in_air and self.armed:
                self.loop.advance(now_s - self._now_s)
            self._now_s = now_s

    def _message(self, number: int) -> Any:
        if number in POSITIONS and not (self.sends_position and self.estimates):
            return None
        return MESSAGES[number](self)

    def measured(self) -> tuple[float, FloatArray, FloatArray]:
        """Return its clock in s, and position and velocity in NED as its sensor sees them now.

        Position and velocity are in m and m/s, shape (3,) each.
        """
        noisy = self.loop.position + self._rng.normal(0.0, self._settings.noise_std_m, 3)
        swapped = [noisy[1], noisy[0], -noisy[2]]
        velocity = self.loop.velocity
        return (
            self.clock_s(self._now_s),
            np.array(swapped),
            np.array([velocity[1], velocity[0], -velocity[2]]),
        )
