"""When a motion takes too long: it should have ended, and it gets no further either."""

from __future__ import annotations

_FACTOR = 1.5
_GRACE_S = 30.0
_UNPACED_GRACE_S = 120.0
"""For a simulator that goes as fast as it can: how fast that is, nobody knows."""


class Overdue:
    """Judges one motion by the clock and by its progress."""

    def __init__(self, wall_duration_s: float, now_s: float) -> None:
        """Begin to judge a motion that takes so long; 0 for as fast as it can."""
        self.grace_s = _GRACE_S if wall_duration_s else _UNPACED_GRACE_S
        self.progress = 0.0
        self.deadline_s = now_s + _FACTOR * wall_duration_s + self.grace_s

    def is_late(self, progress: float, now_s: float) -> bool:
        """Say whether it is overdue, having come as far as `progress`, from 0 to 1."""
        if progress > self.progress:
            self.progress = progress
            self.deadline_s = max(self.deadline_s, now_s + self.grace_s)
        return now_s >= self.deadline_s
