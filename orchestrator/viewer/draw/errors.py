"""Draws the errors of the flights along one path over the time since each began. Imports Rerun.

Rerun has one time axis for everything, on which flights follow one another. This plot is therefore
drawn by hand, as lines in a plane.
"""

from __future__ import annotations

import math

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.axes import round_up
from nufleet.orchestrator.viewer.draw.marks import (
    drawn_at,
    labels_2d,
    lines_2d,
    screen_points,
)
from nufleet.orchestrator.viewer.draw.outline import outline
from nufleet.orchestrator.viewer.draw.palette import ALARM, GRID, QUIET, TEXT, Palette
from nufleet.orchestrator.viewer.draw.paths import frames, labels_of
from nufleet.orchestrator.viewer.flights import Compared, Flight
from nufleet.shared.arrays import FloatArray

PLOT = "tracking/compared"
WIDTH, HEIGHT = 220.0, 80.0
"""Extent of the plot in its own units; x points to the right and y down, as in an image."""

FRAME_S = 1.0
"""Interval between drawings of the flight in progress."""

POINTS = 300
"""Limit on the number of points of a flight."""

ERROR_MIN_MM = 0.1
"""Smallest range of errors that is shown, in thousandths of the unit of the axes."""


class Errors:
    """A view of the flights along one path, all from their beginning at 0 s."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._compared = Compared()
        self._drawn = 0
        self._begins = True
        self._high = (0.0, 0.0)

    def draw(self, flight: Flight, *, over: bool = False) -> None:
        """Draw the new samples of a flight, every `FRAME_S`, and to its end once it is over."""
        before = self._compared.flight
        if not self._compared.takes(flight):
            return
        if flight is not before:
            self._drawn, self._begins = 0, True
            if not flight.compares_with(before):
                self._high = (0.0, 0.0)
        first, self._drawn = self._drawn, len(flight.time_s)
        for frame in frames(flight.time_s, first, FRAME_S, and_last=False):
            self._draw_until(flight, frame + 1)
        if over:
            self._draw_until(flight, len(flight.time_s))

    def _draw_until(self, flight: Flight, samples: int) -> None:
        with drawn_at(self._stream, flight.time_s[samples - 1]):
            error = flight.errors_milli[:samples]
            high = (
                _round(max(self._high[0], samples * flight.sample_time_s), 8),
                _round(max(self._high[1], float(error.max()), ERROR_MIN_MM), 4),
            )
            if high != self._high or self._begins:
                self._high, self._begins = high, False
                self._draw_axes(flight.unit)
                self._draw_earlier()
            colour = self._palette.of_prior(flight.prior)
            self._stream.log(f"{PLOT}/flight", lines_2d([self._line(flight, error)], [colour], 1.8))
            self._draw_marks()
            rows = self._compared.rows()
            gap = min(8.0, (HEIGHT + 8.0) / len(rows))
            places = [[WIDTH + 36.0, gap * k - 4.0] for k in range(len(rows))]
            self._stream.log(f"{PLOT}/names", labels_of(rows, places, self._palette))

    def _draw_earlier(self) -> None:
        flights = self._compared.earlier
        lines = [self._line(flight, flight.errors_milli) for flight in flights]
        colours = [self._palette.of_prior(flight.prior) for flight in flights]
        self._stream.log(f"{PLOT}/earlier", lines_2d(lines, colours, 1.0))

    def _draw_marks(self) -> None:
        """Draw a point where the guard withdrew a prior."""
        flights = [*self._compared.earlier, self._compared.flight]
        taken = [f for f in flights if f is not None and f.taken_back_s is not None]
        places = [
            self._place(f.at(f.taken_back_s or 0.0), f.errors_milli, f.sample_time_s) for f in taken
        ]
        self._stream.log(
            f"{PLOT}/taken_back",
            rr.Points2D(
                np.reshape(places, (-1, 2)),
                colors=[ALARM],
                radii=screen_points(*[4.0] * len(places)),
            ),
        )

    def _line(self, flight: Flight, error: FloatArray) -> FloatArray:
        kept = np.union1d(outline(error, POINTS), [0, len(error) - 1])
        return self._place(kept, error, flight.sample_time_s)

    def _place(self, samples: object, error: FloatArray, sample_time_s: float) -> FloatArray:
        """Return the positions of samples in the plot, shape (samples, 2)."""
        at = np.atleast_1d(np.asarray(samples, dtype=np.intp))
        high_s, high = self._high
        return np.column_stack(
            [at * sample_time_s / high_s * WIDTH, HEIGHT - error[at] / high * HEIGHT]
        )

    def _draw_axes(self, unit: str) -> None:
        high_s, high = self._high
        along, up = _ticks(high_s, 8), _ticks(high, 4)
        across = [tick / high_s * WIDTH for tick in along]
        down = [HEIGHT - tick / high * HEIGHT for tick in up]
        lines = [[[x, 0.0], [x, HEIGHT]] for x in across] + [[[0.0, y], [WIDTH, y]] for y in down]
        frame = [[0.0, 0.0], [0.0, HEIGHT], [WIDTH, HEIGHT]]
        self._stream.log(
            f"{PLOT}/grid", lines_2d([*lines, frame], [GRID] * len(lines) + [QUIET], 0.5)
        )
        # The viewer writes a text below its position.
        texts = [([x, HEIGHT + 1.0], f"{tick:g}") for x, tick in zip(across, along, strict=True)]
        texts += [([-9.0, y - 3.0], f"{tick:g}") for y, tick in zip(down, up, strict=True)]
        texts += [
            ([WIDTH / 2, HEIGHT + 8.0], "s since the flight began"),
            ([-2.0, -11.0], f"m{unit}"),
        ]
        self._stream.log(
            f"{PLOT}/labels",
            labels_2d([place for place, _ in texts], [text for _, text in texts], [TEXT]),
        )


def _round(value: float, ticks: int) -> float:
    step = round_up(value / ticks)
    return step * math.ceil(value / step - 1e-9)


def _ticks(high: float, ticks: int) -> list[float]:
    step = round_up(high / ticks)
    return [step * k for k in range(round(high / step) + 1)]
