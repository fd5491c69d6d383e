"""What a vehicle has told: written by the thread that receives, read by all others.

Every value is replaced as a whole, so that a reader never sees half of one.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np

from nufleet.robot_agent.drivers.mavlink.clock import VehicleClock
from nufleet.robot_agent.drivers.mavlink.frames import enu_of_ned, rotated
from nufleet.robot_agent.drivers.mavlink.profiles import Profile
from nufleet.shared.arrays import FloatArray

BACK_MAX_S = 1.0
"""How far a time stamp may lie before the newest one, since others overtake a packet, or ahead of
the time that has passed since."""

NED_FRAMES = (1, 20)
"""MAV_FRAME_LOCAL_NED, and MAV_FRAME_LOCAL_FRD, as ArduPilot calls it."""

KEPT_AT_REST = 16
"""Number of measurements that are kept while no motion is recorded."""

WARNING = 4
"""MAV_SEVERITY of a warning; more serious texts have lower numbers."""

TEXT_S = 10.0
"""Time for which a text of the vehicle counts as the reason of what happens."""

LINK_SHARE = 0.02
"""Weight of the newest packet in the share of packets that arrive: it counts the last fifty."""

ARMED = 128
"""Bit of `base_mode` in heartbeats."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """One measured position."""

    vehicle_s: float
    """Time stamp, on the vehicle's clock."""
    arrived_s: float
    """Our time when it arrived."""
    position: FloatArray
    """Position (east, north, up) in the vehicle's local frame in m, shape (3,)."""
    velocity: FloatArray
    """Its derivative in m/s, shape (3,)."""


@dataclass(frozen=True)
class Heartbeat:
    """The last heartbeat of the autopilot."""

    arrived_s: float
    """Our time when it arrived."""
    autopilot: int
    """MAV_AUTOPILOT."""
    vehicle_type: int
    """MAV_TYPE."""
    armed: bool
    """Whether the motors are armed."""
    custom_mode: int
    """Mode, in the autopilot's own numbers."""


class Telemetry:
    """Takes the messages of one vehicle, in the order in which they arrive."""

    def __init__(
        self, profile: Profile, system_id: int, own_system_id: int, measured_by: str
    ) -> None:
        """Know nothing of a vehicle.

        Args:
            profile: What its autopilot calls things.
            system_id: MAVLink system id of the vehicle.
            own_system_id: System id of the driver; answers to other ones are ignored.
            measured_by: Message with its measured position.
        """
        self._profile, self._system_id, self._measured_by = profile, system_id, measured_by
        self._answers_to = {0, own_system_id}
        self.clock = VehicleClock()
        """Its clock, compared with ours."""
        self.heartbeat: Heartbeat | None = None
        self.newest: Measurement | None = None
        """Measurement with the latest time stamp."""
        self.charge: float | None = None
        """Charge of the battery, 0 to 1."""
        self.charged_s = 0.0
        """Our time when the charge arrived."""
        self.voltage_v: float | None = None
        self.estimator: int | None = None
        """Flags of its estimator."""
        self.landed: bool | None = None
        """Whether it says that it stands on the ground."""
        self.trouble = ""
        """Why its measurements cannot be trusted any more; empty as long as they can."""
        self.acknowledged: dict[int, int] = {}
        """Last result of each command since it was asked, MAV_RESULT by MAV_CMD."""
        self.parameters: dict[str, float] = {}
        """Values of the vehicle's parameters that arrived, by name."""
        self._texts: deque[tuple[float, str]] = deque(maxlen=4)
        self._sequence: int | None = None
        self._expected = self._arrived = 1.0
        self._source: object = None
        self._left: set[object] = set()
        self._at_rest: deque[Measurement] = deque(maxlen=KEPT_AT_REST)
        self._recorded: list[Measurement] | None = None

    def receive(self, message: Any, source: object, arrived_s: float) -> None:
        """Take one message.

        Args:
            message: The message, of the vehicle's autopilot.
            source: Address that it came from.
            arrived_s: Our time when it arrived.
        """
        self._check_source(source)
        self._count(message.get_seq())
        take = getattr(self, f"_take_{message.get_type().lower()}", None)
        if take is not None:
            take(message, arrived_s)

    @property
    def arriving(self) -> float:
        """Share of the last packets that arrived."""
        return min(1.0, self._arrived / self._expected)

    @property
    def rate_hz(self) -> float:
        """How many measurements a second arrived lately; 0 before there are enough."""
        last = self._at_rest.copy()
        lasted_s = last[-1].arrived_s - last[0].arrived_s if last else 0.0
        return (len(last) - 1) / lasted_s if len(last) == KEPT_AT_REST and lasted_s > 0 else 0.0

    def record(self) -> None:
        """Keep all measurements from now on, and the last few."""
        if self._recorded is None:
            self._recorded = list(self._at_rest.copy())

    def recorded(self) -> list[Measurement]:
        """Return the measurements kept since `record`, by their time stamps."""
        kept = {one.vehicle_s: one for one in list(self._recorded or ())}
        return [kept[at] for at in sorted(kept)]

    def forget(self) -> None:
        """Forget the measurements of the last motion."""
        self._recorded = None

    def words(self, now_s: float) -> str:
        """Return what the vehicle itself said lately, to be added to a sentence, or nothing."""
        said = [text for at_s, text in self._texts.copy() if now_s - at_s < TEXT_S]
        return f"; it says: {' / '.join(dict.fromkeys(said))}" if said else ""

    def _check_source(self, source: object) -> None:
        if source == self._source:
            return
        if source in self._left:
            self.trouble = (
                f"two vehicles, at {self._source} and {source}, answer as system "
                f"{self._system_id}: give each its own {self._profile.id_parameter}"
            )
        self._left.add(self._source)
        self._source = source

    def _count(self, sequence: int) -> None:
        # Packets that were overtaken arrive, too: they count, and expect no other.
        ahead = 1 if self._sequence is None else (sequence - self._sequence) % 256
        if ahead >= 128:
            ahead = 0
        else:
            self._sequence = sequence
        self._expected = (1 - LINK_SHARE) * self._expected + ahead
        self._arrived = (1 - LINK_SHARE) * self._arrived + 1

    def _take_heartbeat(self, message: Any, arrived_s: float) -> None:
        self.heartbeat = Heartbeat(
            arrived_s,
            message.autopilot,
            message.type,
            bool(message.base_mode & ARMED),
            message.custom_mode,
        )

    def _take_local_position_ned(self, message: Any, arrived_s: float) -> None:
        if self._measured_by == "LOCAL_POSITION_NED":
            # Whole milliseconds, rounded down: on average half of one is missing.
            stamp_s = 1e-3 * message.time_boot_ms + 0.5e-3
            velocity = np.array([message.vx, message.vy, message.vz])
            self._take(stamp_s, message, enu_of_ned(velocity), arrived_s)

    def _take_odometry(self, message: Any, arrived_s: float) -> None:
        if self._measured_by == "ODOMETRY":
            if message.frame_id not in NED_FRAMES:
                self.trouble = (
                    f"its ODOMETRY is in frame {message.frame_id}, and MAV_FRAME_LOCAL_NED (1) is "
                    "needed: set measured_by = 'LOCAL_POSITION_NED'"
                )
                return
            velocity = np.array([message.vx, message.vy, message.vz])
            if message.child_frame_id != message.frame_id:  # the body's frame
                velocity = rotated(np.array(message.q), velocity)
            self._take(1e-6 * message.time_usec, message, enu_of_ned(velocity), arrived_s)

    def _take(self, stamp_s: float, message: Any, velocity: FloatArray, arrived_s: float) -> None:
        position = enu_of_ned(np.array([message.x, message.y, message.z]))
        if not np.isfinite(position).all():
            return  # no position: its age says so
        taken, newest = Measurement(stamp_s, arrived_s, position, velocity), self.newest
        step_s = 0.0 if newest is None else stamp_s - newest.vehicle_s
        ahead_s = 0.0 if newest is None else step_s - (arrived_s - newest.arrived_s)
        if step_s < -BACK_MAX_S or ahead_s > BACK_MAX_S:
            went = (
                f"went back by {-step_s:.3g} s" if step_s < 0 else f"jumped {ahead_s:.3g} s ahead"
            )
            self.trouble = (
                f"the time stamps of {self._measured_by} {went}: the vehicle restarted, its clock "
                f"was set, or two vehicles answer as system {self._system_id}; give each its own "
                f"{self._profile.id_parameter}"
            )
        if self._recorded is not None:
            self._recorded.append(taken)
        if newest is None or stamp_s > newest.vehicle_s:
            self._at_rest.append(taken)
            self.newest = taken

    def _take_timesync(self, message: Any, arrived_s: float) -> None:
        if message.tc1:  # an answer; a request has 0
            self.clock.answered(message.ts1, 1e-9 * message.tc1, arrived_s)

    def _take_command_ack(self, message: Any, arrived_s: float) -> None:
        del arrived_s
        if message.target_system in self._answers_to:
            self.acknowledged[message.command] = message.result

    def _take_param_value(self, message: Any, arrived_s: float) -> None:
        del arrived_s
        self.parameters[message.param_id.rstrip("\0")] = message.param_value

    def _take_battery_status(self, message: Any, arrived_s: float) -> None:
        if message.id == 0 and message.battery_remaining >= 0:
            self.charge, self.charged_s = message.battery_remaining / 100, arrived_s
        cells = [cell for cell in message.voltages if cell != 0xFFFF]
        if message.id == 0 and cells:
            self.voltage_v = sum(cells) / 1000

    def _take_sys_status(self, message: Any, arrived_s: float) -> None:
        if message.battery_remaining >= 0:
            self.charge, self.charged_s = message.battery_remaining / 100, arrived_s
        if message.voltage_battery not in {0, 0xFFFF}:
            self.voltage_v = message.voltage_battery / 1000

    def _take_estimator_status(self, message: Any, arrived_s: float) -> None:
        del arrived_s
        self.estimator = message.flags

    _take_ekf_status_report = _take_estimator_status

    def _take_extended_sys_state(self, message: Any, arrived_s: float) -> None:
        del arrived_s
        if message.landed_state:
            self.landed = message.landed_state == 1

    def _take_statustext(self, message: Any, arrived_s: float) -> None:
        if message.severity <= WARNING:
            self._texts.append((arrived_s, message.text.rstrip("\0").strip()))
