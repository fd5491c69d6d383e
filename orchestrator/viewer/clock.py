"""The time axis of a study in seconds of robot motion, also for simulators faster than time."""

from __future__ import annotations

from collections.abc import Callable


class ViewerClock:
    """A clock that follows the wall clock and jumps ahead when simulated robots outrun it.

    A simulated robot may play a minute of motion in a millisecond; on this clock the minute passes.
    """

    def __init__(self, clock_s: Callable[[], float]) -> None:
        self._clock_s = clock_s
        self._origin_s = clock_s()

    def now_s(self) -> float:
        """Return the seconds since the study began."""
        return self._clock_s() - self._origin_s

    def advance_to(self, t_s: float) -> None:
        """Jump ahead to a time in seconds; has no effect when that time has already passed."""
        self._origin_s -= max(0.0, t_s - self.now_s())
