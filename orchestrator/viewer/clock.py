"""The time axis of a study: seconds of robot motion, whether simulated robots race or not."""

from __future__ import annotations

from collections.abc import Callable


class ViewerClock:
    """Runs with the wall clock, and jumps ahead where robots moved for longer than they took.

    A simulated robot plays a minute in a millisecond; on this clock the minute passes.
    """

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._origin_s = clock_s()

    def now_s(self) -> float:
        """Seconds since the study began."""
        return self._clock_s() - self._origin_s

    def advance_to(self, t_s: float) -> None:
        """Jump ahead to a time; does nothing when it has passed already."""
        self._origin_s -= max(0.0, t_s - self.now_s())
