"""Draws each kind of event in the views that show it. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from orchestrator.viewer.draw_estimates import Estimates
from orchestrator.viewer.draw_robots import RobotStates
from orchestrator.viewer.draw_samples import TestSamples
from orchestrator.viewer.draw_sphere import Sphere
from orchestrator.viewer.draw_surrogates import Surrogates
from orchestrator.viewer.events import (
    IterationEvent,
    MessageEvent,
    RobotStateEvent,
    TestSamplesEvent,
    ViewerEvent,
)
from orchestrator.viewer.palette import Palette

_LEVELS = {"debug": "DEBUG", "info": "INFO", "warning": "WARN", "error": "ERROR"}


class Drawing:
    """Everything that is drawn of one study on one stream."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._palette = Palette()
        self._sphere = Sphere(stream, self._palette)
        self._surrogates = Surrogates(stream, self._palette)
        self._estimates = Estimates(stream, self._palette)
        self._robots = RobotStates(stream)
        self._samples = TestSamples(stream, self._palette)

    def begin(self) -> None:
        """Draw what never changes."""
        self._sphere.begin()

    def draw(self, event: ViewerEvent) -> None:
        """Draw an event, or keep it for `end_batch`."""
        match event:
            case RobotStateEvent():
                self._robots.add(event)
            case TestSamplesEvent():
                self._samples.draw(event)
            case IterationEvent():
                self._draw_iteration(event)
            case MessageEvent():
                self._log(event.t_s, event.text, _LEVELS[event.level])

    def end_batch(self) -> None:
        """Draw what was kept to be drawn at once."""
        self._robots.draw()

    def _draw_iteration(self, event: IterationEvent) -> None:
        if self._palette.name_target(event.target):
            self._samples.repaint()
        self._stream.set_time("t", duration=event.t_s)
        self._stream.set_time("iteration", sequence=event.iteration)
        try:
            self._sphere.draw(event)
            self._surrogates.draw(event)
            self._estimates.draw(event)
        finally:
            self._stream.reset_time()
        for text in event.messages:
            self._log(event.t_s, text, "INFO")

    def _log(self, t_s: float, text: str, level: str) -> None:
        self._stream.send_columns(
            "log",
            indexes=[rr.TimeColumn("t", duration=[t_s])],
            columns=rr.TextLog.columns(text=[text], level=[level]),
        )
