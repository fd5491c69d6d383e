"""Detects overdue motions: past their expected end, and without progress."""

from __future__ import annotations

_FACTOR = 1.5
"""Multiple of the expected duration that a motion may take before its grace period begins."""

_GRACE_S = 30.0
"""Time in s without any progress after which a late motion is overdue."""

_UNPACED_GRACE_S = 120.0
"""Grace period in s for an unpaced simulator, whose speed is not known in advance."""


class Overdue:
    """Judges one motion by the clock and by its progress."""

    def __init__(self, wall_duration_s: float, now_s: float) -> None:
        """Start judging a motion.

        Args:
            wall_duration_s: Expected duration in s of wall time; 0 for an unpaced simulator.
            now_s: Current monotonic time in s.
        """
        self.grace_s = _GRACE_S if wall_duration_s else _UNPACED_GRACE_S
        self.progress = 0.0
        self.deadline_s = now_s + _FACTOR * wall_duration_s + self.grace_s

    def is_late(self, progress: float, now_s: float) -> bool:
        """Return whether the motion is overdue.

        Args:
            progress: Completed part of the motion, from 0 to 1.
            now_s: Current monotonic time in s.
        """
        if progress > self.progress:
            self.progress = progress
            self.deadline_s = max(self.deadline_s, now_s + self.grace_s)
        return now_s >= self.deadline_s
