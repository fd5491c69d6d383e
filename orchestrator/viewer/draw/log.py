"""Writes the log. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from nufleet.orchestrator.viewer.draw.marks import drawable, send
from nufleet.orchestrator.viewer.events import MessageLevel

_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR"}


class Log:
    """The log of a study. Times are part of the text: the view's own column is too narrow."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream

    def say(self, t_s: float, level: MessageLevel, text: str) -> None:
        """Write a sentence to the log, at a time in seconds on the viewer's clock."""
        send(
            self._stream,
            "log",
            [t_s],
            rr.TextLog.columns(text=[drawable(f"{t_s:7.1f} s  {text}")], level=[_LEVELS[level]]),
        )
