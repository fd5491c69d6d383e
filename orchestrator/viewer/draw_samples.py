"""Draws the reference and the response of the running tests. Imports Rerun."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import pairwise

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from orchestrator.viewer.events import TestSamplesEvent
from orchestrator.viewer.palette import REFERENCE, Colour, Palette
from shared.arrays import FloatArray

POINTS_MAX = 2000
"""Points drawn of one signal of one test; a screen is not wider."""


class TestSamples:
    """Reference and response over time, one pair of lines for each robot and axis.

    Before the first round is over all are shown, from then on the target and the leading sources.
    """

    __test__ = False  # pytest: not a test case

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._units: dict[tuple[str, str], str] = {}
        self._painted: dict[str, tuple[Colour, bool]] = {}
        self._shown: set[str] | None = None

    def draw(self, event: TestSamplesEvent) -> None:
        """Draw one test."""
        if (event.robot, event.axis) not in self._units:
            self._units[event.robot, event.axis] = event.unit
            self._painted.pop(event.robot, None)
            self._paint()
        for signal, values in (("reference", event.reference), ("response", event.response)):
            kept = outline(values, POINTS_MAX)
            if not len(kept):
                continue
            self._stream.send_columns(
                f"tests/{signal}/{event.robot}/{event.axis}",
                indexes=[rr.TimeColumn("t", duration=event.t_s + kept * event.sample_time_s)],
                columns=rr.Scalars.columns(scalars=values[kept]),
            )

    def show(self, target: str, leaders: Iterable[str]) -> None:
        """Show these robots, in the palette's colours, and no others."""
        self._shown = {target, *leaders}
        self._paint()

    def _paint(self) -> None:
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


def outline(values: FloatArray, points_max: int) -> NDArray[np.intp]:
    """Return the indices of at most `points_max` samples that draw the same line.

    Each of points_max / 2 equal stretches keeps its lowest and its highest sample, so no peak is
    lost; a short signal keeps all.

    Args:
        values: shape (n,).

    Returns:
        Increasing indices, shape (≤ points_max,).
    """
    n = len(values)
    if n <= points_max:
        return np.arange(n)
    edges = np.linspace(0, n, points_max // 2 + 1).astype(int)
    kept = set[int]()
    for start, end in pairwise(edges):
        stretch = values[start:end]
        kept |= {start + int(np.argmin(stretch)), start + int(np.argmax(stretch))}
    return np.array(sorted(kept))
