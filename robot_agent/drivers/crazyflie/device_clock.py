"""Dates measurements on the clock of this machine by the time stamps of a device."""

from __future__ import annotations

from collections import deque

import numpy as np

from nufleet.robot_agent.drivers.clock_drift import drift
from nufleet.shared.arrays import FloatArray

STAMP_MS = 1 << 24
"""Time stamps of a Crazyflie's log count milliseconds in 24 bits, and begin again after 4.7 h."""

DISORDER_MAX_S = 1.0
"""How far the stamp of a measurement may lie before the newest one, or ahead of this machine."""

ODD_MAX = 5
"""Measurements in a row of `ODD_OF` that may lie further off before the stamps count as those of
more than one clock. Single ones are dropped: a machine that was frozen lets some pass very late."""
ODD_OF = 20

KEPT_S = 120
"""How long the least delayed measurement of each second is kept."""

SKEW_MAX = 2e-4
SKEW_SPAN_S = 10.0
"""Largest relative error of two quartz clocks against each other, and the shortest time over which
it is estimated at all."""


class DeviceClock:
    """The clock of one device, as its time stamps show it.

    A measurement that waited in a queue arrives late, never early. The line below all delays
    therefore shows how the two clocks differ, but for the smallest delay, which stays unknown.
    """

    def __init__(self) -> None:
        self._newest_ms: int | None = None
        self._least: deque[tuple[float, float]] = deque(maxlen=KEPT_S)
        self._odd: deque[bool] = deque(maxlen=ODD_OF)
        self.fault: str | None = None
        """Why the stamps cannot be those of one clock; None while they can."""

    def take(self, stamp_ms: int, arrived_s: float) -> float | None:
        """Take the stamp of a measurement that has arrived.

        Args:
            stamp_ms: Stamp, modulo 2^24.
            arrived_s: When it arrived, on the clock of this machine.

        Returns:
            The device's time in s, unwrapped; None if it cannot be determined. Where that happens
            often, `fault` says why.
        """
        if self._newest_ms is None:
            self._newest_ms = stamp_ms
        step_ms = (stamp_ms - self._newest_ms + STAMP_MS // 2) % STAMP_MS - STAMP_MS // 2
        device_s = 1e-3 * (self._newest_ms + step_ms)
        delay_s = arrived_s - device_s
        least_s = min((one for _, one in self._least), default=delay_s)
        odd = None
        if -1e-3 * step_ms > DISORDER_MAX_S:
            odd = (
                f"the time stamps go back by {-1e-3 * step_ms:.2f} s: it was restarted, or two "
                "drones have its address"
            )
        elif least_s - delay_s > DISORDER_MAX_S:
            odd = (
                f"the time stamps jump ahead by {least_s - delay_s:.2f} s: two drones may have its "
                "address"
            )
        self._odd.append(odd is not None)
        if odd is not None:
            if sum(self._odd) > ODD_MAX:
                self.fault = odd
            return None
        self._newest_ms += max(0, step_ms)
        if self._least and int(device_s) == int(self._least[-1][0]):
            if delay_s < self._least[-1][1]:
                self._least[-1] = (device_s, delay_s)
        elif not self._least or device_s > self._least[-1][0]:
            self._least.append((device_s, delay_s))
        return device_s

    def host_s(self, device_s: FloatArray) -> FloatArray:
        """Return when measurements were taken on the clock of this machine, shape (measurements,).

        Args:
            device_s: Times that `take` returned, shape (measurements,).
        """
        times, delays = np.array(self._least).reshape(-1, 2).T
        if not len(times):
            return device_s
        skew = 0.0
        if times[-1] - times[0] > SKEW_SPAN_S:
            skew = drift(times, delays, drift_max=SKEW_MAX)
        dated: FloatArray = device_s + skew * device_s + (delays - skew * times).min()
        return dated
