"""The frame that a path is drawn in: two axes at one scale, with ticks at round numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.viewer.draw.axes import HEIGHT, WIDTH, round_up
from nufleet.shared.arrays import FloatArray

EXTENT_MIN = 0.05
"""Smallest extent to show, in the unit of the axes; it applies before the robot has moved."""

_MARGIN = 0.06  # share of the path's extent that is left free on each side for deviations from it
_TICKS = 6  # about this many intervals along the longer axis


@dataclass(frozen=True)
class PathAxes:
    """The range that is shown on the two axes, in their unit."""

    low: tuple[float, float]
    """Lower ends (x, y), multiples of `step`."""
    high: tuple[float, float]
    """Upper ends (x, y), multiples of `step`."""
    step: float
    """Distance between two ticks."""

    @property
    def scale(self) -> float:
        """Units of the plot per unit of the axes."""
        across, up = (high - low for low, high in zip(self.low, self.high, strict=True))
        return min(WIDTH / across, HEIGHT / up)

    @property
    def shift(self) -> tuple[float, float]:
        """Position of the axes' origin in the plot: x to the right, y down."""
        middle = [(low + high) / 2 for low, high in zip(self.low, self.high, strict=True)]
        return WIDTH / 2 - self.scale * middle[0], HEIGHT / 2 + self.scale * middle[1]

    def place(self, points: FloatArray) -> FloatArray:
        """Return the positions of points in the plot.

        Args:
            points: Points of the path in the unit of the axes, shape (n, 2).

        Returns:
            Positions in the units of the plot, x to the right and y down, shape (n, 2).
        """
        return np.asarray(np.array(self.shift) + points * np.array([self.scale, -self.scale]))

    def ticks(self, axis: int) -> list[float]:
        """Return the round numbers on axis 0 (x) or 1 (y), both ends included."""
        first, last = (round(v[axis] / self.step) for v in (self.low, self.high))
        return [k * self.step for k in range(first, last + 1)]


def axes_around(desired: FloatArray) -> PathAxes:
    """Return axes that show a path with some room around it.

    Args:
        desired: Points of the path in the unit of the axes, shape (n, 2).
    """
    low, high = desired.min(axis=0), desired.max(axis=0)
    extent = max(float((high - low).max()), EXTENT_MIN)
    step = round_up(extent / _TICKS)
    low, high = low - _MARGIN * extent, high + _MARGIN * extent
    firsts = [step * math.floor(float(v) / step) for v in low]
    lasts = [step * math.ceil(float(v) / step) for v in high]
    return PathAxes((firsts[0], firsts[1]), (lasts[0], lasts[1]), step)
