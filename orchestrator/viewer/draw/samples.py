"""Draws the references and responses of running tests. Imports Rerun."""

from __future__ import annotations

import math
from collections.abc import Iterable
from typing import Literal

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.marks import send
from nufleet.orchestrator.viewer.draw.outline import outline
from nufleet.orchestrator.viewer.draw.palette import REFERENCE, Colour, Palette
from nufleet.orchestrator.viewer.events import TestSamplesEvent
from nufleet.shared.arrays import FloatArray

POINTS_MAX = 2000
"""Limit on the points drawn of one signal of one test, about the width of a screen."""

POINTS_PER_S = 200.0
"""Limit on the points drawn per second, for tests that arrive in parts; enough for any wave that a
robot can follow."""


class TestSamples:
    """A view of references and responses over time, one pair of lines for each robot and axis.

    All robots are shown until the first round is over, then the target and the leading sources.
    """

    __test__ = False  # pytest: not a test case

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._waiting: dict[tuple[str, str], list[TestSamplesEvent]] = {}
        self._units: dict[tuple[str, str], str] = {}
        self._painted: dict[str, tuple[Colour, bool]] = {}
        self._shown: set[str] | None = None

    def add(self, event: TestSamplesEvent) -> None:
        """Keep a test, or a part of one, for the next `draw`."""
        self._waiting.setdefault((event.robot, event.axis), []).append(event)

    def draw(self) -> None:
        """Draw the events that were kept, in one message for each signal."""
        waiting, self._waiting = self._waiting, {}
        for (robot, axis), events in waiting.items():
            if (robot, axis) not in self._units:
                self._units[robot, axis] = events[0].unit
                self._painted.pop(robot, None)
                self.paint()
            self._draw_signal(f"tests/reference/{robot}/{axis}", events, "reference")
            self._draw_signal(f"tests/response/{robot}/{axis}", events, "response")

    def _draw_signal(
        self, path: str, events: list[TestSamplesEvent], signal: Literal["reference", "response"]
    ) -> None:
        times_s, values = [], []
        for event in events:
            samples: FloatArray = getattr(event, signal)
            seconds = len(samples) * event.sample_time_s
            kept = outline(samples, min(POINTS_MAX, 2 * math.ceil(seconds * POINTS_PER_S / 2)))
            times_s.append(event.t_s + kept * event.sample_time_s)
            values.append(samples[kept])
        send(
            self._stream,
            path,
            np.concatenate(times_s),
            rr.Scalars.columns(scalars=np.concatenate(values)),
        )

    def show(self, target: str, leaders: Iterable[str]) -> None:
        """Show the target and the leading sources in the palette's colours, and hide all others."""
        self._shown = {target, *leaders}
        self.paint()

    def paint(self) -> None:
        """Give every robot the colour that it has now."""
        for robot in {robot for robot, _ in self._units}:
            colour = self._palette.of(robot)
            shown = self._shown is None or robot in self._shown
            if self._painted.get(robot) != (colour, shown):
                self._painted[robot] = (colour, shown)
                self._paint_robot(robot, colour, shown=shown)

    def _paint_robot(self, robot: str, colour: Colour, *, shown: bool) -> None:
        axes = [(axis, unit) for (name, axis), unit in self._units.items() if name == robot]
        for axis, unit in axes:
            for signal, paint, width in (("reference", REFERENCE, 1.0), ("response", colour, 1.5)):
                self._stream.log(
                    f"tests/{signal}/{robot}/{axis}",
                    rr.SeriesLines(
                        colors=[paint],
                        widths=[width],
                        names=[f"{robot} {axis} {signal} [{unit}]"],
                        visible_series=[shown],
                    ),
                    static=True,
                )
