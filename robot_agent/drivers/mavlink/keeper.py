"""What continues by itself while a vehicle is connected: heartbeats, clocks, held set-points.

PX4 leaves offboard mode half a second to a second after the last set-point. Set-points therefore
stream between motions, too, and in a motion whose next sample does not come.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.robot_agent.drivers.mavlink.clock import VehicleClock

HEARTBEAT_S = 1.0
"""Time between two heartbeats of ours."""

TIMESYNC_S = 0.1
"""Time between two comparisons of the clocks."""

LATE_SAMPLES = 3
"""Number of sample times without a set-point after which the last one is held."""

REPEAT_S = 0.05
"""Time between two repetitions of a command that cuts the motors."""


class Keeper:
    """Says what is due; `beat` is called on one thread, all else on others."""

    def __init__(
        self, send: Callable[[Any], None], clock: VehicleClock, sample_time_s: float
    ) -> None:
        """Prepare to keep one vehicle.

        Args:
            send: Function that sends a message.
            clock: The vehicle's clock, to be compared with ours.
            sample_time_s: Time between two set-points.
        """
        self._send, self._clock, self._sample_time_s = send, clock, sample_time_s
        self._held: Any = None
        self._last_s = -1.0
        self._holding = False
        self._repeated: Any = None
        self._cut = self._abandoned = False
        self._heartbeat_s = self._timesync_s = -1.0

    def sent(self, held: Any, now_s: float) -> None:
        """Note that a set-point was sent.

        Args:
            held: Set-point to repeat if no other follows: the same place, at rest.
            now_s: Time at which it was sent.
        """
        self._held, self._last_s, self._holding = held, now_s, False
        self._abandoned = False

    def release(self) -> None:
        """Send no set-points any more."""
        self._held = None

    def abandon(self) -> None:
        """Send neither set-points nor heartbeats, as if this computer were gone.

        The vehicle's failsafe then lands it: PX4 misses set-points, ArduPilot heartbeats.
        """
        self._held, self._abandoned = None, True

    def repeat(self, message: Any) -> None:
        """Send a message again and again; None ends it. No set-points are sent any more."""
        self._cut, self._repeated = True, message

    def beat(self, now_s: float) -> float:
        """Send what is due; return when something is due next."""
        if now_s >= self._heartbeat_s:
            self._heartbeat_s = now_s + HEARTBEAT_S
            if not self._abandoned:
                self._send(
                    dialect.MAVLink_heartbeat_message(
                        dialect.MAV_TYPE_ONBOARD_CONTROLLER,
                        dialect.MAV_AUTOPILOT_INVALID,
                        0,
                        0,
                        dialect.MAV_STATE_ACTIVE,
                        3,
                    )
                )
        if now_s >= self._timesync_s:
            self._timesync_s = now_s + TIMESYNC_S
            self._send(dialect.MAVLink_timesync_message(0, self._clock.request(now_s)))
        due_s = min(self._heartbeat_s, self._timesync_s)
        repeated, held = self._repeated, self._held
        if repeated is not None:
            self._send(repeated)
            return min(due_s, now_s + REPEAT_S)
        if held is None or self._cut:
            return min(due_s, now_s + self._sample_time_s)
        wait = 1 if self._holding else LATE_SAMPLES
        hold_s = self._last_s + wait * self._sample_time_s
        if now_s >= hold_s:
            self._send(held)
            self._holding = True
            # Counted from when it was due, so that the rate is exact on average.
            late = now_s - hold_s > self._sample_time_s
            self._last_s = now_s if late else hold_s
            hold_s = self._last_s + self._sample_time_s
        return min(due_s, hold_s)
