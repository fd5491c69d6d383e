"""Draws each kind of event in the views that show it. Imports Rerun."""

from __future__ import annotations

from collections.abc import Callable

import rerun as rr

from nufleet.orchestrator.viewer import events
from nufleet.orchestrator.viewer.draw.differences import Differences
from nufleet.orchestrator.viewer.draw.estimates import Estimates, summary
from nufleet.orchestrator.viewer.draw.log import Log
from nufleet.orchestrator.viewer.draw.marks import drawn_at
from nufleet.orchestrator.viewer.draw.palette import Palette
from nufleet.orchestrator.viewer.draw.robots import RobotStates
from nufleet.orchestrator.viewer.draw.samples import TestSamples
from nufleet.orchestrator.viewer.draw.sphere import Sphere
from nufleet.orchestrator.viewer.draw.surrogates import Surrogates
from nufleet.orchestrator.viewer.draw.tracking import Tracking
from nufleet.orchestrator.viewer.running_tests import RunningTests
from nufleet.orchestrator.viewer.shown import Shown


class Scene:
    """Everything that one stream shows of a study, drawn by one object per view."""

    def __init__(self, stream: rr.RecordingStream) -> None:
        self._stream = stream
        self._palette = Palette()
        self.shown = Shown()
        self._sphere = Sphere(stream, self._palette)
        self._differences = Differences(stream, self._palette)
        self._surrogates = Surrogates(stream, self._palette)
        self._estimates = Estimates(stream, self._palette)
        self._log = Log(stream)
        self._robots = RobotStates(stream, self._log)
        self._samples = TestSamples(stream, self._palette)
        self._running = RunningTests()
        self._tracking = Tracking(stream, self._palette, self.shown)

    def begin(self) -> None:
        """Draw the static parts, which never change."""
        self._sphere.begin()
        self._surrogates.begin()

    def draw(self, event: events.ViewerEvent) -> None:
        """Draw an event at once, or keep it until `rest` draws the whole batch."""
        match event:
            case events.RobotStateEvent():
                self._robots.add(event)
            case events.TestSamplesEvent():
                self.shown.ranking()
                self._samples.add(event)
                self._running.add(event)
            case events.IterationEvent():
                self.shown.ranking()
                self._draw_iteration(event)
            case events.TrackingSamplesEvent():
                self._tracking.add(event)
            case events.TakenBackEvent():
                self._tracking.add(event)
                text = f"{event.flight}: prior withdrawn: {event.reason}"
                self._log.say(event.t_s, "warning", text)
            case events.MessageEvent():
                self._log.say(event.t_s, event.level, event.text)

    @property
    def rest(self) -> tuple[Callable[[], None], ...]:
        """Functions that draw the events kept from a batch, each in one message per signal."""
        return self._robots.draw, self._samples.draw, self._draw_running, self._tracking.draw

    def end(self) -> None:
        """Draw what is known only when no more events come."""
        self._tracking.end()

    def _draw_running(self, *, last: bool = False) -> None:
        """Draw what the tests in progress have shown up to now."""
        for answers in self._running.look(last=last):
            sources = [robot for robot in answers.responses if robot != answers.target]
            self._palette.assign(answers.target, sources)
            self._samples.paint()
            with drawn_at(self._stream, answers.t_s):
                self._sphere.draw(answers)
                self._differences.draw(answers)
                self._surrogates.draw_running(answers)
                self._estimates.draw_running(answers)

    def _draw_iteration(self, event: events.IterationEvent) -> None:
        self._draw_running(last=True)
        leaders = event.leaders
        self._running.end(leaders)
        self._palette.assign(event.target, [row.robot for row in event.ranking])
        self._samples.show(event.target, leaders)
        with drawn_at(self._stream, event.t_s):
            self._stream.set_time("iteration", sequence=event.iteration)
            self._sphere.draw(event.answers)
            self._differences.draw(event.answers)
            self._surrogates.draw(event)
            self._estimates.draw(event)
        for text in (summary(event), *event.messages):
            self._log.say(event.t_s, "info", text)
