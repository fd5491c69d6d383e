"""Draws the reference and the response of the running tests. Imports Rerun."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from orchestrator.viewer.events import TestSamplesEvent
from orchestrator.viewer.palette import REFERENCE, Palette
from shared.arrays import FloatArray

POINTS_MAX = 2000
"""Points drawn of one signal of one test; a screen is not wider."""


class TestSamples:
    """Reference and response over time, one pair of lines for each robot and axis."""

    __test__ = False  # pytest: not a test case

    def __init__(self, stream: rr.RecordingStream, palette: Palette) -> None:
        self._stream = stream
        self._palette = palette
        self._seen: dict[tuple[str, str], str] = {}

    def draw(self, event: TestSamplesEvent) -> None:
        """Draw one test."""
        if (event.robot, event.axis) not in self._seen:
            self._seen[event.robot, event.axis] = event.unit
            self._paint(event.robot, event.axis, event.unit)
        name = f"{event.robot}/{event.axis}"
        for signal, values in (("reference", event.reference), ("response", event.response)):
            kept = outline(values, POINTS_MAX)
            if not len(kept):
                continue
            self._stream.send_columns(
                f"tests/{signal}/{name}",
                indexes=[rr.TimeColumn("t", duration=event.t_s + kept * event.sample_time_s)],
                columns=rr.Scalars.columns(scalars=values[kept]),
            )

    def repaint(self) -> None:
        """Take the colours from the palette again."""
        for (robot, axis), unit in self._seen.items():
            self._paint(robot, axis, unit)

    def _paint(self, robot: str, axis: str, unit: str) -> None:
        for signal, colour, width in (
            ("reference", REFERENCE, 1.0),
            ("response", self._palette.of(robot), 2.0),
        ):
            self._stream.log(
                f"tests/{signal}/{robot}/{axis}",
                rr.SeriesLines(
                    colors=[colour], widths=[width], names=[f"{robot} {axis} {signal} [{unit}]"]
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
