"""Draws the flights along one path from above, to compare how close they keep. Imports Rerun."""

from __future__ import annotations

import numpy as np
import rerun as rr

from nufleet.orchestrator.viewer.draw.axes import WIDTH
from nufleet.orchestrator.viewer.draw.marks import (
    drawn_at,
    labels_2d,
    lines_2d,
    screen_points,
    send,
)
from nufleet.orchestrator.viewer.draw.outline import thinned
from nufleet.orchestrator.viewer.draw.palette import GROUND, TEXT, WANTED, Palette, subdued
from nufleet.orchestrator.viewer.draw.path_axes import METRES, PLOT, draw_axes
from nufleet.orchestrator.viewer.draw.path_frame import PathAxes, axes_around
from nufleet.orchestrator.viewer.flights import Compared, Flight, Row
from nufleet.shared.arrays import FloatArray

FRAME_S, TRAIL_S = 0.25, 2.0
"""Interval between drawings of the flight in progress, and span of its past drawn as a bright trail
behind the robot."""

BODY_FRAME_S = 1.0
"""Interval between drawings of the part before the bright trail."""

TRAIL_POINTS, BODY_POINTS = 60, 400
"""Limits on the number of points of the trail and of a whole flight."""

BODY, EARLIER = 0.75, 0.45
"""Brightness of the flight in progress before its trail, and of earlier flights."""


class Paths:
    """A view of the path, the current and earlier flights, and where priors were withdrawn."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._axes: PathAxes | None = None
        self._compared = Compared()
        self._longest: FloatArray = np.empty((0, 2))
        self._drawn = 0
        self._begun = False

    def draw(self, flight: Flight) -> None:
        """Draw the new samples of a flight of a robot with two or more axes."""
        before = self._compared.flight
        if not self._compared.takes(flight):
            return
        if flight is not before:
            self._begin(flight, before)
        first, self._drawn = self._drawn, len(flight.time_s)
        self._draw_path(flight)
        self._draw_trail(flight, frames(flight.time_s, first, FRAME_S, and_last=True))
        body = frames(flight.time_s, first, BODY_FRAME_S, and_last=False)
        self._draw_body(flight, body)
        if body or flight.taken_back_s is not None or self._compared.whole:
            self._draw_names(flight)
        self._draw_places(flight)

    def _begin(self, flight: Flight, before: Flight | None) -> None:
        if not self._begun:
            self._begun = True
            self._draw_once()
        self._drawn = 0
        if not flight.compares_with(before):
            self._longest, self._axes = np.empty((0, 2)), None
        with drawn_at(self._stream, flight.time_s[0]):
            self._draw_earlier()
            for what in ("actual", "places", "taken_back"):
                self._stream.log(f"{METRES}/{what}", rr.Clear(recursive=False))

    def _draw_once(self) -> None:
        """Fix the order in which the parts cover one another."""
        for order, part in enumerate(("earlier", "desired", "actual", "trail"), start=40):
            self._stream.log(
                f"{METRES}/{part}", rr.LineStrips2D.from_fields(draw_order=order), static=True
            )
        for order, part in enumerate(("trail", "places"), start=60):
            self._stream.log(
                f"{METRES}/{part}", rr.Points2D.from_fields(draw_order=order), static=True
            )

    def _draw_path(self, flight: Flight) -> None:
        """Draw the path as far as its longest flight went, and axes that fit it."""
        if len(flight.desired) <= len(self._longest):
            return
        self._longest = flight.desired[:, :2]
        axes = axes_around(self._longest)
        with drawn_at(self._stream, flight.time_s[-1]):
            self._stream.log(
                f"{METRES}/desired", lines_2d([thinned(self._longest, BODY_POINTS)], [WANTED], 0.5)
            )
            if axes != self._axes:
                self._axes = axes
                draw_axes(self._stream, axes, flight.axes[:2], flight.unit)

    def _draw_trail(self, flight: Flight, frames: list[int]) -> None:
        """Draw the robot at each frame, with the bright trail behind it."""
        if not frames:
            return
        colour = self._palette.of_prior(flight.prior)
        trails = []
        for frame in frames:
            begin = flight.at(flight.time_s[frame] - TRAIL_S)
            trails.append(thinned(flight.actual[begin : frame + 1, :2], TRAIL_POINTS))
        send(
            self._stream,
            f"{METRES}/trail",
            flight.time_s[frames],
            [
                *rr.LineStrips2D.columns(
                    strips=trails,
                    colors=[colour] * len(frames),
                    radii=screen_points(*[1.8] * len(frames)),
                ),
                *rr.Points2D.columns(
                    positions=flight.actual[frames, :2],
                    colors=[colour] * len(frames),
                    radii=screen_points(*[5.0] * len(frames)),
                ),
            ],
        )

    def _draw_body(self, flight: Flight, frames: list[int]) -> None:
        if not frames:
            return
        colour = subdued(self._palette.of_prior(flight.prior), BODY)
        send(
            self._stream,
            f"{METRES}/actual",
            flight.time_s[frames],
            rr.LineStrips2D.columns(
                strips=[thinned(flight.actual[: frame + 1, :2], BODY_POINTS) for frame in frames],
                colors=[colour] * len(frames),
                radii=screen_points(*[1.2] * len(frames)),
            ),
        )

    def _draw_earlier(self) -> None:
        """Draw the earlier flights, those with smaller errors on top."""
        flights = sorted(self._compared.earlier, key=lambda flight: -flight.rms_error)
        self._stream.log(
            f"{METRES}/earlier",
            lines_2d(
                [thinned(flight.actual[:, :2], BODY_POINTS) for flight in flights],
                [subdued(self._palette.of_prior(flight.prior), EARLIER) for flight in flights],
                0.6,
            ),
        )

    def _draw_places(self, flight: Flight) -> None:
        """Draw a ring at each place where a prior was withdrawn; this flight's ring has a label."""
        taken = [f for f in (*self._compared.earlier, flight) if f.taken_back_s is not None]
        if not taken:
            return
        colours = [self._palette.of_prior(f.prior) for f in taken]
        dim = [
            c if f is flight else subdued(c, EARLIER) for c, f in zip(colours, taken, strict=True)
        ]
        places = np.array([f.actual[f.at(f.taken_back_s or 0.0), :2] for f in taken])
        with drawn_at(self._stream, flight.time_s[-1]):
            self._stream.log(
                f"{METRES}/places",
                rr.Points2D(
                    np.concatenate([places, places]),
                    colors=[*dim, *[GROUND] * len(taken)],
                    radii=screen_points(*[6.0] * len(taken), *[3.5] * len(taken)),
                ),
            )
            if flight.taken_back_s is not None:
                self._stream.log(
                    f"{METRES}/taken_back",
                    labels_2d(places[-1:], ["prior withdrawn"], colours[-1:]),
                )

    def _draw_names(self, flight: Flight) -> None:
        rows = self._compared.rows()
        places = [[WIDTH + 26.0, 8.0 * k] for k in range(len(rows))]
        with drawn_at(self._stream, flight.time_s[-1]):
            self._stream.log(f"{PLOT}/names", labels_of(rows, places, self._palette))


def labels_of(rows: list[Row], places: list[list[float]], palette: Palette) -> rr.Points2D:
    """Return the rows of a list of flights as texts, each in the colour of its prior."""
    colours = [TEXT if row.prior is None else palette.of_prior(row.prior) for row in rows]
    return labels_2d(places, [row.text for row in rows], colours)


def frames(time_s: FloatArray, first: int, every_s: float, *, and_last: bool) -> list[int]:
    """Return the indices of the samples, from `first` on, at which a new frame begins."""
    # The small term keeps a sample exactly on a frame's boundary from rounding into the one before.
    frame = np.floor((time_s - time_s[0]) / every_s + 1e-9)
    new = np.flatnonzero(np.diff(frame, prepend=0.0) > 0)
    frames = [int(k) for k in new if k >= first]
    if and_last and len(time_s) - 1 not in frames and len(time_s) > first:
        frames.append(len(time_s) - 1)
    return frames
