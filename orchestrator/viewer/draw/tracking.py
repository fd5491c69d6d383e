"""Draws flights along paths: the robot's position and its inverse model. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from nufleet.orchestrator.viewer.draw.errors import Errors
from nufleet.orchestrator.viewer.draw.marks import send
from nufleet.orchestrator.viewer.draw.palette import Palette
from nufleet.orchestrator.viewer.draw.paths import Paths
from nufleet.orchestrator.viewer.draw.signals import Signals
from nufleet.orchestrator.viewer.events import TakenBackEvent, TrackingSamplesEvent
from nufleet.orchestrator.viewer.flights import Flight, Outcomes
from nufleet.orchestrator.viewer.shown import Shown

TABLE_EVERY_S = 1.0
"""Interval between writes of the table of errors, on the viewer's clock."""


class Tracking:
    """The views of flights along paths, of one or several robots."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette, shown: Shown) -> None:
        self._stream = stream
        self._shown = shown
        self._paths = Paths(stream, palette)
        self._errors = Errors(stream, palette)
        self._signals = Signals(stream, palette)
        self._outcomes = Outcomes()
        self._tabled_s: float | None = None
        self._waiting: list[TrackingSamplesEvent | TakenBackEvent] = []
        self._flights: dict[str, Flight] = {}

    def add(self, event: TrackingSamplesEvent | TakenBackEvent) -> None:
        """Keep a part of a flight, or the guard's event, for the next `draw`."""
        self._waiting.append(event)

    def draw(self) -> None:
        """Draw the events that were kept, in one message for each signal of each flight."""
        waiting, self._waiting = self._waiting, []
        for event in waiting:
            if isinstance(event, TakenBackEvent):
                flight = self._flights.get(event.robot)
                if flight is not None and flight.label == event.flight:
                    flight.taken_back_s = event.t_s
            elif len(event.actual):
                self._take(event)
        for robot in {event.robot: None for event in waiting if event.robot in self._flights}:
            self._draw_new(self._flights[robot])

    def end(self) -> None:
        """Write the outcomes of the last flights, of which parts came since the last table."""
        for flight in self._flights.values():
            self._end(flight)

    def _take(self, event: TrackingSamplesEvent) -> None:
        flight = self._flights.get(event.robot)
        if flight is not None and flight.continued_by(event):
            flight.add(event)
            return
        if flight is not None:
            self._draw_new(flight)
            self._signals.end(flight)
            self._end(flight)
        mixed = event.weights is not None
        self._shown.tracking(event.axes, event.unit, event.t_s, mixed=mixed)
        self._flights[event.robot] = Flight.begun_by(event)

    def _draw_new(self, flight: Flight) -> None:
        if len(flight.axes) > 1:
            self._paths.draw(flight)
        self._errors.draw(flight)
        self._signals.draw(flight)
        now_s = float(flight.time_s[-1])
        if self._tabled_s is None or abs(now_s - self._tabled_s) >= TABLE_EVERY_S:
            self._table(flight)

    def _end(self, flight: Flight) -> None:
        self._errors.draw(flight, over=True)
        self._table(flight)

    def _table(self, flight: Flight) -> None:
        self._tabled_s = float(flight.time_s[-1])
        self._outcomes.note(flight)
        send(
            self._stream,
            "tracking/flights",
            [self._tabled_s],
            rr.TextDocument.columns(
                text=[self._outcomes.table()], media_type=[rr.MediaType.MARKDOWN]
            ),
        )
