"""Puts the time stamps of another clock on this computer's, and keeps what arrived with them."""

from __future__ import annotations

import math
import threading
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from nufleet.robot_agent.drivers.clock_drift import drift
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError

KEPT = 100_000
"""Measurements kept: more than ten minutes at 100 Hz."""

HISTORY_S = 60.0
"""Time before a motion whose messages help to compare the clocks."""

SPACING_MIN = 0.4
"""Shortest time between two measurements that are used, as a share of their usual one."""

JUMP_MAX_S = 1.0
"""Time by which a message may be faster than the fastest one before it."""

JUMP_AFTER_S = 2.0
"""Time for which messages have to have come before: the first one may have waited for long."""

AHEAD_MAX_S = 0.02
"""Time by which a synchronised stamp may lie ahead of its arrival."""

DRIFT_MAX = 1e-3
"""Largest difference in rate between two clocks; more is no clock, but too few messages."""

ASTRAY_MAX_S = 0.02
"""Time by which a larger difference in rate may make the clocks differ over the messages compared;
delays of the first and last of them explain as much."""

DRIFT_SPAN_S = 5.0
"""Shortest span of messages from which a difference in rate is estimated."""


@dataclass(frozen=True)
class Arrived:
    """One measurement, and when it arrived."""

    stamp_s: float
    """Its time: its stamp, or its arrival if stamps mean nothing."""
    arrived_s: float
    """Time of its arrival, on the driver's clock."""
    values: Mapping[str, float]
    """Value of each component or joint."""
    late_s: float = 0.0
    """How much longer than the fastest messages it took to arrive; for synchronised clocks, how
    long it took."""


class Arrivals:
    """The measurements of a topic; for any threads.

    A stamp that goes backwards is refused, and so is everything after it.
    """

    def __init__(
        self,
        topic: str,
        components: Sequence[str],
        stamps: Literal["own-clock", "synchronised", "arrival", "simulated"],
    ) -> None:
        """Begin without a measurement.

        Args:
            topic: Name of the topic, for messages.
            components: Components or joints that are needed.
            stamps: What time stamps mean, as in `MeasurementTopic`; `simulated` ones are of the
                clock that the driver follows, and may come before the clock's own message.
        """
        self._topic, self._components, self._stamps = topic, tuple(components), stamps
        self._changed = threading.Condition()
        self._kept: deque[Arrived] = deque(maxlen=KEPT)
        self._count = 0
        self._problem: str | None = None
        self._least_delay_s = self._usual_delay_s = math.inf
        self._others: frozenset[str] = frozenset()

    def take(self, stamp_s: float | None, arrived_s: float, values: Mapping[str, float]) -> None:
        """Take a measurement; repetitions and messages about other joints alone are passed over.

        Args:
            stamp_s: Its time stamp, on the driver's clock if it is synchronised or simulated; None
                if it has none.
            arrived_s: When it arrived, on the driver's clock.
            values: Value of each component or joint.
        """
        if self._stamps == "arrival":
            stamp_s = arrived_s
        with self._changed:
            if not any(name in values for name in self._components):
                self._others |= values.keys()
                return
            last = self._kept[-1] if self._kept else None
            if last is not None and stamp_s == last.stamp_s:
                return
            problem = self._wrong(stamp_s, arrived_s, values, last)
            if problem is not None:
                self._problem = self._problem or problem
            elif self._problem is None and stamp_s is not None:
                needed = {name: values[name] for name in self._components}
                late_s = self._late_s(stamp_s, arrived_s, last)
                self._kept.append(Arrived(stamp_s, arrived_s, needed, late_s))
                self._count += 1
            self._changed.notify_all()

    def newest(self) -> Arrived | None:
        """Return the newest measurement; None before the first.

        Raises:
            RobotError: A measurement was refused.
        """
        with self._changed:
            if self._problem is not None:
                raise RobotError(self._problem)
            return self._kept[-1] if self._kept else None

    def next(self, timeout_s: float) -> Arrived:
        """Wait for the next measurement.

        Raises:
            RobotError: None came, or it was refused.
        """
        with self._changed:
            before = self._count
            self._changed.wait_for(
                lambda: self._count > before or self._problem is not None, timeout_s
            )
            if self._problem is None and self._count == before:
                others = f"; it has only {', '.join(sorted(self._others))}" if self._others else ""
                raise RobotError(
                    f"nothing came of {', '.join(self._components)} on {self._topic} for "
                    f"{timeout_s:.2g} s{others}"
                )
        arrived = self.newest()
        assert arrived is not None  # noqa: S101 - one has just been counted
        return arrived

    def since(self, begin_s: float) -> tuple[FloatArray, FloatArray]:
        """Return the measurements taken since a time, and the last one before it.

        Of a burst that a publisher made up for a delay with, only the first is returned.

        Args:
            begin_s: The time, on the driver's clock.

        Returns:
            Their times on the driver's clock, shape (measurements,), and their values, shape
            (measurements, components).
        """
        with self._changed:
            kept = [one for one in self._kept if one.arrived_s >= begin_s - HISTORY_S]
        stamp_s = np.array([one.stamp_s for one in kept])
        arrived_s = np.array([one.arrived_s for one in kept])
        if self._stamps == "own-clock" and kept:
            stamp_s = on_receiving_clock(stamp_s, arrived_s)
        first = max(0, int(np.searchsorted(stamp_s, begin_s)) - 1)
        apart = [first + i for i in spaced(stamp_s[first:])]
        values = [[kept[i].values[name] for name in self._components] for i in apart]
        return stamp_s[apart], np.array(values).reshape(-1, len(self._components))

    def _late_s(self, stamp_s: float, arrived_s: float, last: Arrived | None) -> float:
        """Return how late a message has arrived."""
        if self._stamps == "synchronised":
            return arrived_s - stamp_s
        # The clocks may drift apart, which makes all messages appear later and later.
        drifted_s = 0.0 if last is None else DRIFT_MAX * (stamp_s - last.stamp_s)
        delay_s = arrived_s - stamp_s
        self._usual_delay_s = min(self._usual_delay_s + drifted_s, delay_s)
        return delay_s - self._usual_delay_s

    def _wrong(
        self,
        stamp_s: float | None,
        arrived_s: float,
        values: Mapping[str, float],
        last: Arrived | None,
    ) -> str | None:
        """Return what is wrong with a measurement; None if it is good."""
        missing = [name for name in self._components if name not in values]
        if missing:
            there = ", ".join(sorted(values))
            return f"{self._topic} has no {', '.join(missing)}; it has {there}"
        wrong = [name for name in self._components if not np.isfinite(values[name])]
        if wrong:
            return (
                f"{self._topic} reported a {wrong[0]} that is not finite, or an orientation that "
                "is none: the robot has no position estimate"
            )
        if stamp_s is None:
            return (
                f"the messages on {self._topic} have no time stamp: have their publisher fill "
                'header.stamp, or state stamps = "arrival"'
            )
        if last is not None and stamp_s < last.stamp_s:
            return (
                f"the time stamps on {self._topic} went back by {last.stamp_s - stamp_s:.3g} s: "
                "its clock was set, or two programs publish there"
            )
        # A message that waited arrives late, and none arrives early.
        jump_s = self._least_delay_s - (arrived_s - stamp_s)
        self._least_delay_s = min(self._least_delay_s, arrived_s - stamp_s)
        known_s = arrived_s - self._kept[0].arrived_s if self._kept else 0.0
        if known_s > JUMP_AFTER_S and jump_s > JUMP_MAX_S:
            return f"the time stamps on {self._topic} jumped by {jump_s:.3g} s: its clock was set"
        if self._stamps == "synchronised" and stamp_s > arrived_s + AHEAD_MAX_S:
            return (
                f"the time stamps on {self._topic} are {stamp_s - arrived_s:.3g} s ahead of this "
                'computer\'s clock: synchronise them with chrony, or state stamps = "own-clock"'
            )
        return None


def spaced(times_s: FloatArray) -> list[int]:
    """Return the indices of times that are not much closer than usual to the last one returned.

    A curve through two noisy measurements at nearly the same time is steep, and far off beside
    them.

    Args:
        times_s: Times, shape (measurements,), increasing.
    """
    if len(times_s) < 3:
        return list(range(len(times_s)))
    least_s = SPACING_MIN * float(np.median(np.diff(times_s)))
    chosen = [0]
    for i in range(1, len(times_s)):
        if times_s[i] - times_s[chosen[-1]] >= least_s:
            chosen.append(i)
    return chosen


def on_receiving_clock(stamp_s: FloatArray, arrived_s: FloatArray) -> FloatArray:
    """Return time stamps of another clock as times of the clock that the arrivals are on.

    No message arrives before it was sent. Of all linear relations between the clocks that respect
    this, the one with the least total delay is taken. What remains unknown is the time that the
    fastest messages travelled.

    Args:
        stamp_s: Time stamps, shape (messages,), increasing.
        arrived_s: Times of arrival, shape (messages,).

    Raises:
        RobotError: The clocks differ in rate by more than clocks do.
    """
    origin_s = float(stamp_s.mean())
    along_s, late_s = stamp_s - origin_s, arrived_s - stamp_s
    if np.ptp(along_s) < DRIFT_SPAN_S:
        return stamp_s + float(late_s.min())
    rate = drift(stamp_s, late_s, drift_max=math.inf)
    if (abs(rate) - DRIFT_MAX) * np.ptp(along_s) > ASTRAY_MAX_S:
        raise RobotError(
            f"the time stamps of the measurements run {abs(rate):.2%} "
            f"{'slower' if rate > 0 else 'faster'} than this computer's clock, more than clocks "
            'do: correct the clock of their publisher, or state stamps = "arrival"'
        )
    rate = float(np.clip(rate, -DRIFT_MAX, DRIFT_MAX))
    offset_s = float(np.min(late_s - rate * along_s))
    placed: FloatArray = stamp_s + offset_s + rate * along_s
    return placed
