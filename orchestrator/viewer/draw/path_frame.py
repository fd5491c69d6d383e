"""Where a path and its scales are drawn: both axes at one scale, in round numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.viewer.draw.axes import HEIGHT, WIDTH, round_up
from nufleet.shared.arrays import FloatArray

EXTENT_MIN = 0.05
"""Before the robot has moved, so much is shown."""

_MARGIN = 0.06  # of the path's extent, for what lies beside it
_TICKS = 6


@dataclass(frozen=True)
class PathAxes:
    """What is shown on each axis: from `low` to `high`, both in steps of `step`."""

    low: tuple[float, float]
    high: tuple[float, float]
    step: float

    @property
    def scale(self) -> float:
        """The drawing's units per unit of the axes."""
        across, up = (high - low for low, high in zip(self.low, self.high, strict=True))
        return min(WIDTH / across, HEIGHT / up)

    @property
    def shift(self) -> tuple[float, float]:
        """Where the origin of the axes is in the drawing: x to the right, y down."""
        middle = [(low + high) / 2 for low, high in zip(self.low, self.high, strict=True)]
        return WIDTH / 2 - self.scale * middle[0], HEIGHT / 2 + self.scale * middle[1]

    def place(self, points: FloatArray) -> FloatArray:
        """Return where points (n, 2) of the path are in the drawing, shape (n, 2)."""
        return np.asarray(np.array(self.shift) + points * np.array([self.scale, -self.scale]))

    def ticks(self, axis: int) -> list[float]:
        """The round numbers on an axis, both ends included."""
        first, last = (round(v[axis] / self.step) for v in (self.low, self.high))
        return [k * self.step for k in range(first, last + 1)]


def axes_around(desired: FloatArray) -> PathAxes:
    """Return axes that show a path (n, 2) with some room around it."""
    low, high = desired.min(axis=0), desired.max(axis=0)
    extent = max(float((high - low).max()), EXTENT_MIN)
    step = round_up(extent / _TICKS)
    low, high = low - _MARGIN * extent, high + _MARGIN * extent
    firsts = [step * math.floor(float(v) / step) for v in low]
    lasts = [step * math.ceil(float(v) / step) for v in high]
    return PathAxes((firsts[0], firsts[1]), (lasts[0], lasts[1]), step)
