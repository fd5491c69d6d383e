"""Notices that the whole process was frozen: what it finds on waking is from a time that is over.

A goal that waited in the socket of a frozen process may be one whose orchestrator has gone since,
or has interrupted it and heard nothing; and whether its token is gone is not known at once. So an
agent that wakes takes no goal before it has had the time to hear. Who still wants it asks again.
"""

from __future__ import annotations

import threading

from nufleet.shared.wire.messages import Refusal

FROZEN_S = 2.0
"""Beats further apart than this mean that the process was frozen; as long as a session's lease."""

HEARING_S = 1.0
"""How long a process that woke waits for news of who is there."""


class Freezes:
    """Told regularly that the process runs, asked whether it may take a goal; from any thread."""

    def __init__(self, now_s: float) -> None:
        """Begin at a time of a monotonic clock."""
        self._lock = threading.Lock()
        self._beat_s = now_s
        self._woke_s = now_s - HEARING_S

    def beat(self, now_s: float) -> None:
        """Note that the process runs."""
        with self._lock:
            self._note(now_s)

    def refusal(self, now_s: float) -> Refusal | None:
        """Return why no goal is taken now; None when the process has run for a while."""
        with self._lock:
            self._note(now_s)
            if now_s - self._woke_s >= HEARING_S:
                return None
        return Refusal(
            code="frozen",
            reason="this agent was frozen until a moment ago and has not heard yet who is there; "
            "ask again",
        )

    def _note(self, now_s: float) -> None:
        if now_s - self._beat_s > FROZEN_S:
            self._woke_s = now_s
        self._beat_s = now_s
