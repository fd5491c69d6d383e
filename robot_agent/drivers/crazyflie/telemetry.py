"""What a Crazyflie logs: measured states with their times, battery, supervisor, variances."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.device_clock import DeviceClock
from nufleet.shared.arrays import FloatArray

STATE_VARIABLES = (
    *((f"stateEstimate.{name}", "float") for name in ("x", "y", "z")),
    *((f"stateEstimate.{name}", "FP16") for name in ("vx", "vy", "vz")),
    ("stateEstimateZ.quat", "uint32_t"),
)
"""The block of states and how its variables are sent. Up to nine variables are set up in one
packet; cflib would repeat a second one whose answer got lost, and the block would grow."""

STATUS_VARIABLES = (
    ("pm.vbat", None),
    ("supervisor.info", None),
    *((f"kalman.var{axis}", "FP16") for axis in ("PX", "PY", "PZ")),
)
"""The block of the status, which is sent more rarely."""

STATUS_PERIOD_S = 0.1
"""Time between two statuses."""

STEADY_STATUSES = 10
"""Number of consecutive statuses over which the variances must not change for the estimate to count
as settled."""

STEADY_M2 = 1e-3
"""Range in which they stay."""

LOST_M2 = 0.25
"""Variance of a position that is lost."""

BEFORE_SAMPLES = 100
"""Measurements that are kept from before a motion."""

LINK_SAMPLES = 200
"""Measurements over which the share of those that arrive is counted."""


@dataclass(frozen=True, eq=False)
class Measurement:
    """One logged state, in the estimator's frame."""

    device_s: float
    """When it was taken, on the drone's clock."""
    arrived_s: float
    """When it arrived, on the monotonic clock of this machine."""
    position_m: FloatArray
    """Position, shape (3,)."""
    velocity_m_s: FloatArray
    """Velocity, shape (3,)."""
    thrust_axis: FloatArray
    """The body's z axis, along which it thrusts, shape (3,)."""
    yaw_rad: float
    """Direction of its front, counter-clockwise from the x axis."""


@dataclass(frozen=True)
class Status:
    """What is logged more rarely."""

    arrived_s: float
    """When it arrived, on the monotonic clock of this machine."""
    battery_v: float
    """Voltage of the battery."""
    supervisor: int
    """Bits of `Supervisor`."""
    variance_m2: float
    """Largest variance of the estimated position."""


class Telemetry:
    """Keeps what the link's thread delivers for the other threads."""

    def __init__(self, log_period_s: float) -> None:
        self._period_s = log_period_s
        self._changed = threading.Condition()
        self._clock = DeviceClock()
        self._measured: list[Measurement] = []
        self._recording = False
        self._came_s: deque[float] = deque(maxlen=LINK_SAMPLES)
        self._variances: deque[float] = deque(maxlen=STEADY_STATUSES)
        self.newest: Measurement | None = None
        """The newest measurement."""
        self.taken = 0
        """Number of measurements."""
        self.status: Status | None = None
        """The newest status."""

    @property
    def fault(self) -> str | None:
        """Why the measurements cannot be those of one drone; None while they can."""
        return self._clock.fault

    def take_state(self, stamp_ms: int, values: Mapping[str, float], arrived_s: float) -> None:
        """Take a block of states, with the stamp in ms that it bears."""
        row = [float(values[name]) for name, _ in STATE_VARIABLES]
        with self._changed:
            device_s = self._clock.take(stamp_ms, arrived_s)
            if device_s is not None and np.isfinite(row).all():
                taken = _measurement(device_s, arrived_s, row)
                self._measured.append(taken)
                self.taken += 1
                if self.newest is None or device_s > self.newest.device_s:
                    self.newest = taken
                if not self._recording:
                    del self._measured[:-BEFORE_SAMPLES]
                self._came_s.append(device_s)
            self._changed.notify_all()

    def take_status(self, values: Mapping[str, float], arrived_s: float) -> None:
        """Take a block of the status."""
        battery, supervisor, *variances = (float(values[name]) for name, _ in STATUS_VARIABLES)
        with self._changed:
            variance_m2 = float(np.max(variances))  # NaN if one of them is
            self._variances.append(variance_m2)
            self.status = Status(arrived_s, battery, int(supervisor), variance_m2)
            self._changed.notify_all()

    def forget_variances(self) -> None:
        """Begin again to watch whether the estimate settles."""
        with self._changed:
            self._variances.clear()

    @property
    def steady(self) -> bool:
        """Whether the variances of the position have settled, so that it knows where it is."""
        with self._changed:
            seen = np.array(self._variances)
        full = len(seen) == STEADY_STATUSES and bool(np.isfinite(seen).all())
        return full and float(np.ptp(seen)) < STEADY_M2 and float(seen[-1]) < LOST_M2

    @property
    def arriving(self) -> float | None:
        """Share of the measurements that arrive; None before there are enough of them."""
        with self._changed:
            came_s = np.array(self._came_s)
        if len(came_s) < LINK_SAMPLES:
            return None
        return min(1.0, (len(came_s) - 1) * self._period_s / max(float(np.ptp(came_s)), 1e-9))

    def wait_for(self, condition: Callable[[], bool], timeout_s: float) -> bool:
        """Wait until a condition holds that what is logged decides; return whether it does."""
        with self._changed:
            return self._changed.wait_for(
                lambda: self.fault is not None or condition(), timeout_s
            ) and (self.fault is None)

    def begin_recording(self) -> None:
        """Keep all measurements from now on, and those just before."""
        with self._changed:
            self._recording = True

    def end_recording(self) -> None:
        """Forget them."""
        with self._changed:
            self._recording = False
            del self._measured[:-BEFORE_SAMPLES]

    def dated(self) -> tuple[FloatArray, FloatArray]:
        """Return the kept measurements, in the order in which they were taken.

        Returns:
            Times on the monotonic clock of this machine, shape (measurements,), and positions,
            shape (measurements, 3).
        """
        with self._changed:
            device_s = np.array([one.device_s for one in self._measured])
            positions = np.array([one.position_m for one in self._measured]).reshape(-1, 3)
            # Packets overtake one another on some links, and some come twice.
            device_s, order = np.unique(device_s, return_index=True)
            return self._clock.host_s(device_s), positions[order]

    def dated_newest(self) -> float:
        """Return when the newest measurement was taken on the clock of this machine."""
        with self._changed:
            if self.newest is None:
                return -math.inf
            return float(self._clock.host_s(np.array([self.newest.device_s]))[0])


def _measurement(device_s: float, arrived_s: float, row: list[float]) -> Measurement:
    x, y, z, w = quaternion_of(int(row[6]))
    thrust = np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
    yaw_rad = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    return Measurement(device_s, arrived_s, np.array(row[:3]), np.array(row[3:6]), thrust, yaw_rad)


def quaternion_of(compressed: int) -> list[float]:
    """Return the quaternion x, y, z, w that the firmware packs into 32 bits (`quatcompress.h`).

    Two bits name the largest component, which is positive; three times ten bits are sign and
    magnitude of the others.
    """
    largest, parts = compressed >> 30, [0.0] * 4
    for k in (3, 2, 1, 0):
        if k != largest:
            size = (compressed & 511) / 511 / math.sqrt(2)
            parts[k] = -size if compressed & 512 else size
            compressed >>= 10
    parts[largest] = math.sqrt(max(0.0, 1.0 - sum(part * part for part in parts)))
    return parts
