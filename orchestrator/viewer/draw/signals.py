"""Draws a flight over time: its error, the inverse model and its share. Imports Rerun."""

from __future__ import annotations

import math

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from nufleet.orchestrator.flights.labels import NO_PRIOR
from nufleet.orchestrator.viewer.draw.marks import send
from nufleet.orchestrator.viewer.draw.outline import outline
from nufleet.orchestrator.viewer.draw.palette import ALARM, REFERENCE, Colour, Palette
from nufleet.orchestrator.viewer.events import TrackingSamplesEvent
from nufleet.orchestrator.viewer.flights import Flight
from nufleet.shared.arrays import FloatArray

POINTS_PER_S = 40.0
"""Limit on the points drawn per second of a signal, for views that show a minute or two."""

BAND_DEVIATIONS = 2.0
"""Half width of the band around the mean, in standard deviations. Rerun draws one standard
deviation around a measurement, so variances are multiplied by the square of this."""


class Signals:
    """A view of time series coloured by the source of the prior, with gaps between flights."""

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._styled: set[str] = set()
        self._open: dict[str, set[str]] = {}
        self._marked: dict[str, float] = {}

    def draw(self, flight: Flight) -> None:
        """Draw the new samples of a flight, in one message for each signal."""
        new, flight.new = flight.new, []
        if new:
            time_s = flight.time_s[-sum(len(event.actual) for event in new) :]
            self._draw_error(flight, time_s, new)
            if len(flight.axes) == 1:
                self._draw_position(flight, time_s, new)
            # Without an inverse at work there is no model to draw.
            if any(event.variance.any() for event in new):
                self._draw_inverse(flight, time_s, new)
                self._draw_share(flight, time_s, new)
                self._draw_weights(flight, time_s, new)
        self._mark(flight)

    def end(self, flight: Flight) -> None:
        """End the lines of a flight, so that those of the next one are not joined to them."""
        after_s = float(flight.time_s[-1]) + flight.sample_time_s / 2
        for path in sorted(self._open.pop(flight.robot, set())):
            send(self._stream, path, [after_s], rr.Clear.columns(is_recursive=[False]))

    def _draw_error(
        self, flight: Flight, time_s: FloatArray, new: list[TrackingSamplesEvent]
    ) -> None:
        error = 1e3 * np.linalg.norm(_joined(new, "actual") - _joined(new, "desired"), axis=1)
        # One entity per prior, and not only one colour, so that the viewer can name the lines.
        path = f"tracking/error/{flight.robot}/{flight.prior}"
        self._line(flight, path, f"{flight.prior} [m{flight.unit}]", 1.5)
        self._send(path, time_s, error, _kept(error, flight))

    def _draw_position(
        self, flight: Flight, time_s: FloatArray, new: list[TrackingSamplesEvent]
    ) -> None:
        for signal, width in (("desired", 1.0), ("actual", 1.5)):
            path = f"tracking/{signal}/{flight.robot}"
            values = _joined(new, signal)[:, 0]
            grey = signal == "desired"
            self._line(flight, path, f"{signal} [{flight.unit}]", width, grey=grey)
            self._send(path, time_s, values, _kept(values, flight))

    def _draw_inverse(
        self, flight: Flight, time_s: FloatArray, new: list[TrackingSamplesEvent]
    ) -> None:
        prior, mean, variance = (_joined(new, name) for name in ("prior", "mean", "variance"))
        for column, axis in enumerate(flight.axes):
            path = f"tracking/prior/{axis}/{flight.robot}"
            self._line(flight, path, f"prior {axis} [{flight.unit}/s]", 1.0, grey=True)
            self._send(path, time_s, prior[:, column], _kept(prior[:, column], flight))
            path = f"tracking/gp/{axis}/{flight.robot}"
            kept = _kept(mean[:, column], flight)
            first = self._opened(flight, path)
            send(
                self._stream,
                path,
                time_s[kept],
                rr.Measurements.columns(
                    values=mean[kept, column], variances=BAND_DEVIATIONS**2 * variance[kept, column]
                ),
            )
            if first:
                send(
                    self._stream,
                    path,
                    [flight.time_s[0]],
                    rr.Measurements.columns(
                        colors=[self._palette.of_prior(flight.prior)],
                        widths=[1.5],
                        names=[f"GP {axis} ± 2σ [{flight.unit}/s]"],
                    ),
                )

    def _draw_share(
        self, flight: Flight, time_s: FloatArray, new: list[TrackingSamplesEvent]
    ) -> None:
        share = np.concatenate([event.share for event in new])
        path = f"tracking/share/{flight.robot}"
        self._line(flight, path, "share", 1.5)
        # The share is mostly constant: both ends of each change draw the whole line.
        change = np.flatnonzero(np.diff(share))
        kept = np.unique(np.concatenate([[0, len(share) - 1], change, change + 1]))
        self._send(path, time_s, share, kept)

    def _draw_weights(
        self, flight: Flight, time_s: FloatArray, new: list[TrackingSamplesEvent]
    ) -> None:
        """Draw the weight of every source in a mixture and of none, in the sources' colours."""
        parts = [event.weights for event in new if event.weights is not None]
        if len(parts) < len(new):
            return
        weights = np.concatenate(parts)
        for column, name in enumerate((*new[0].experts, NO_PRIOR)):
            path = f"tracking/weights/{flight.robot}/{name}"
            self._line(flight, path, name, 1.5, colour=self._palette.of_prior(name))
            self._send(path, time_s, weights[:, column], _kept(weights[:, column], flight))

    def _mark(self, flight: Flight) -> None:
        """Mark where the guard withdrew the prior, once the samples have arrived."""
        at_s = flight.taken_back_s
        if at_s is None or at_s > flight.time_s[-1] or self._marked.get(flight.robot) == at_s:
            return
        self._marked[flight.robot] = at_s
        k = flight.at(at_s)
        error = 1e3 * float(np.linalg.norm(flight.actual[k] - flight.desired[k]))
        for signal, value in (("error", error), ("share", 1.0)):
            path = f"tracking/taken_back/{signal}/{flight.robot}"
            if path not in self._styled:
                self._styled.add(path)
                style = rr.SeriesPoints(
                    colors=[ALARM], markers=["cross"], marker_sizes=[5.0], names=["withdrawn"]
                )
                self._stream.log(path, style, static=True)
            self._send(path, flight.time_s[k : k + 1], np.array([value]), np.array([0]))

    def _line(
        self,
        flight: Flight,
        path: str,
        name: str,
        width: float,
        *,
        grey: bool = False,
        colour: Colour | None = None,
    ) -> None:
        """Set the style of a line, and its colour for this flight, that of its prior if None."""
        colour = REFERENCE if grey else colour or self._palette.of_prior(flight.prior)
        if path not in self._styled:
            self._styled.add(path)
            style = rr.SeriesLines.from_fields(
                names=[name], widths=[width], aggregation_policy=rr.components.AggregationPolicy.Off
            )
            self._stream.log(path, style, static=True)
        if self._opened(flight, path):
            send(self._stream, path, [flight.time_s[0]], rr.SeriesLines.columns(colors=[colour]))

    def _opened(self, flight: Flight, path: str) -> bool:
        """Return whether nothing of this signal has been drawn in this flight, and note it."""
        paths = self._open.setdefault(flight.robot, set())
        if path in paths:
            return False
        paths.add(path)
        return True

    def _send(
        self, path: str, time_s: FloatArray, values: FloatArray, kept: NDArray[np.intp]
    ) -> None:
        send(self._stream, path, time_s[kept], rr.Scalars.columns(scalars=values[kept]))


def _joined(events: list[TrackingSamplesEvent], name: str) -> FloatArray:
    return np.concatenate([getattr(event, name) for event in events])


def _kept(values: FloatArray, flight: Flight) -> NDArray[np.intp]:
    # An even number of points, since `outline` keeps two for each stretch.
    seconds = len(values) * flight.sample_time_s
    return outline(values, 2 * math.ceil(seconds * POINTS_PER_S / 2))
