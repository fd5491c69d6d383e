"""How a vehicle's clock relates to ours, by MAVLink's TIMESYNC.

We send a request at our time s. The vehicle answers with its time v, and the answer arrives at our
time a. Since nothing arrives before it is sent, the vehicle's clock minus ours lies between v − a
and v − s, however irregular the link is. Of many exchanges the bounds that are tightest hold: each
for its own time exactly, and for another time as far as the two clocks may have drifted apart. The
middle of both bounds is the estimate, and half their distance is its largest possible error.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from nufleet.shared.arrays import FloatArray

DRIFT_MAX = 1e-4
"""Largest relative error of a vehicle's clock; a crystal keeps 5e-5."""

WINDOW_S = 10.0
"""Exchanges further than this from a time bound nothing there that closer ones do not."""

KEPT = 8192
"""Number of exchanges that are kept, some fifteen minutes of them."""


class VehicleClock:
    """Collects exchanges, and converts the vehicle's times to ours."""

    def __init__(self) -> None:
        self._asked: deque[int] = deque(maxlen=64)
        self._exchanges: deque[tuple[float, float, float]] = deque(maxlen=KEPT)

    def request(self, now_s: float) -> int:
        """Return the number of a request that is sent now: our time in ns."""
        number = round(1e9 * now_s)
        self._asked.append(number)
        return number

    def answered(self, number: int, vehicle_s: float, arrived_s: float) -> None:
        """Take an answer; one to the request of another ground station is ignored.

        Args:
            number: Number of the request.
            vehicle_s: The vehicle's time when it answered.
            arrived_s: Our time when the answer arrived.
        """
        if number in self._asked.copy():
            self._exchanges.append((1e-9 * number, vehicle_s, arrived_s))

    @property
    def exchanges(self) -> int:
        """Number of exchanges until now."""
        return len(self._exchanges)

    def offset(self, at_s: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the vehicle's clock minus ours at times of ours, and its largest possible error.

        Args:
            at_s: Times, shape (times,), increasing.

        Returns:
            The offsets and their bounds in s, both of shape (times,). The bounds are infinite
            without an exchange.
        """
        exchanges = np.array(self._exchanges.copy()).reshape(-1, 3)
        offset, bound = np.zeros(len(at_s)), np.full(len(at_s), np.inf)
        if not len(exchanges):
            return offset, bound
        sent, vehicle, arrived = exchanges.T
        for k, time_s in enumerate(at_s):
            near = slice(
                np.searchsorted(arrived, time_s - WINDOW_S),
                np.searchsorted(arrived, time_s + WINDOW_S),
            )
            if near.start >= near.stop:
                near = slice(-1, None) if near.start else slice(0, 1)
            most = vehicle[near] - sent[near] + DRIFT_MAX * np.abs(sent[near] - time_s)
            least = vehicle[near] - arrived[near] - DRIFT_MAX * np.abs(arrived[near] - time_s)
            high, low = most.min(), least.max()
            offset[k], bound[k] = (high + low) / 2, (high - low) / 2
        return offset, bound

    def ours(self, vehicle_s: FloatArray) -> FloatArray:
        """Return our times of the vehicle's times, shape (times,), both increasing."""
        if not len(vehicle_s) or not self._exchanges:
            return vehicle_s.copy()
        sent, vehicle, _ = self._exchanges[-1]
        roughly = vehicle_s - (vehicle - sent)
        # The offset changes slowly; one knot a second is closer than the bounds.
        knots = np.linspace(roughly[0], roughly[-1], 2 + int(roughly[-1] - roughly[0]))
        offset, _ = self.offset(knots)
        converted: FloatArray = vehicle_s - np.interp(roughly, knots, offset)
        return converted
