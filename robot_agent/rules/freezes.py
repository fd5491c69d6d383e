"""Detects that the whole process was frozen, and refuses goals until it has caught up.

A goal that waited in the socket of a frozen process may be out of date: its orchestrator may have
gone since, or have interrupted the goal and received no answer, and the loss of its liveliness
token is not known at once. An agent that wakes therefore takes no goal before it has had time to
receive such news. An orchestrator that still wants the goal sends it again.
"""

from __future__ import annotations

import threading

from nufleet.shared.wire.messages import Refusal

FROZEN_S = 2.0
"""Time between two beats beyond which the process was frozen; equal to a session's lease."""

HEARING_S = 1.0
"""Time that a process waits after waking for news of which orchestrators are alive."""


class Freezes:
    """Decides from regular beats of the process whether it may take a goal; usable from any thread.

    All times come from one monotonic clock, in seconds.
    """

    def __init__(self, now_s: float) -> None:
        """Begin at the present time, with no freeze in the past."""
        self._lock = threading.Lock()
        self._beat_s = now_s
        self._woke_s = now_s - HEARING_S

    def beat(self, now_s: float) -> None:
        """Record that the process runs at this time."""
        with self._lock:
            self._note(now_s)

    def refusal(self, now_s: float) -> Refusal | None:
        """Return why no goal is taken now; None when the process has run for `HEARING_S`."""
        with self._lock:
            self._note(now_s)
            if now_s - self._woke_s >= HEARING_S:
                return None
        return Refusal(
            code="frozen",
            reason="this agent was frozen until a moment ago and does not know yet which "
            "orchestrators are alive; ask again",
        )

    def _note(self, now_s: float) -> None:
        if now_s - self._beat_s > FROZEN_S:
            self._woke_s = now_s
        self._beat_s = now_s
