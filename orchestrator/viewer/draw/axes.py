"""Scales and ticks of a plot that is drawn by hand: positions of values, and round numbers."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.study.interface import Curve
from nufleet.shared.arrays import FloatArray

WIDTH, HEIGHT = 160.0, 125.0
"""Extent of the plot in its own units; x points to the right and y down, as in an image."""


@dataclass(frozen=True)
class Axes:
    """A logarithmic axis for frequencies and a linear axis from 0 for chordal distances."""

    omega_min_rad_s: float
    """Frequency at the left edge."""
    omega_max_rad_s: float
    """Frequency at the right edge."""
    psi_max: float
    """Chordal distance at the top."""

    def x(self, omega_rad_s: FloatArray) -> FloatArray:
        """Return the horizontal positions of frequencies, in the plot's units, of the same shape.

        Frequencies outside the plot are placed on its edge.
        """
        low, high = math.log(self.omega_min_rad_s), math.log(self.omega_max_rad_s)
        share = (np.log(omega_rad_s) - low) / max(high - low, 1e-9)
        return np.clip(share, 0.0, 1.0) * WIDTH

    def y(self, psi: FloatArray) -> FloatArray:
        """Return the vertical positions of distances, in the plot's units, of the same shape.

        Distances outside the plot are placed on its edge.
        """
        return (1.0 - np.clip(psi / self.psi_max, 0.0, 1.0)) * HEIGHT

    def omega_ticks_rad_s(self) -> list[float]:
        """Return 1, 2 and 5 of every decade within the band."""
        first = math.floor(math.log10(self.omega_min_rad_s))
        last = math.ceil(math.log10(self.omega_max_rad_s))
        ticks = [m * 10.0**e for e in range(first, last + 1) for m in (1, 2, 5)]
        low, high = self.omega_min_rad_s * (1 - 1e-9), self.omega_max_rad_s * (1 + 1e-9)
        return [tick for tick in ticks if low <= tick <= high]

    def psi_ticks(self) -> list[float]:
        """Return 0 and at most five round distances above it, up to the top of the plot."""
        step = round_up(self.psi_max / 5)
        return [k * step for k in range(int(self.psi_max / step * (1 + 1e-9)) + 1)]


def fitting_axes(curves: Sequence[Curve]) -> Axes:
    """Return axes that show all medians and samples, and the bands unless these are very wide."""
    highest = max(max(float(c.median.max()), float(c.sampled_psi.max(initial=0.0))) for c in curves)
    band = max(float(c.high.max()) for c in curves)
    return axes_over(
        min(float(c.omega_rad_s.min()) for c in curves),
        max(float(c.omega_rad_s.max()) for c in curves),
        max(1.1 * highest, min(band, 3.0 * highest)),
    )


def axes_over(omega_min_rad_s: float, omega_max_rad_s: float, psi: float) -> Axes:
    """Return axes for frequencies between two and for distances up to a round one above `psi`."""
    shown = min(max(psi, 1e-6), 1.0)
    step = round_up(shown / 5)
    return Axes(omega_min_rad_s, omega_max_rad_s, step * math.ceil(shown / step - 1e-9))


def round_up(value: float) -> float:
    """Return the smallest of 1, 2, 5, 10, … that is at least `value`, which is positive."""
    decade = 10.0 ** math.floor(math.log10(value))
    return next(m * decade for m in (1, 2, 5, 10) if m * decade >= value * (1 - 1e-9))


def spread(places: FloatArray, *, gap: float, within: float) -> FloatArray:
    """Return positions at least `gap` apart, in the same order and near the original ones.

    A first pass pushes positions up until each keeps its distance from the one below; a second pass
    pushes them back towards 0 where they would exceed `within`.

    Args:
        places: Positions along one axis, in any order, shape (n,).
        gap: Smallest distance between two positions.
        within: Largest position that is allowed.

    Returns:
        New positions in the order of the given ones, shape (n,).
    """
    order = np.argsort(places, kind="stable")
    moved = np.asarray(places, dtype=np.float64)[order]
    for k in range(1, len(moved)):
        moved[k] = max(moved[k], moved[k - 1] + gap)
    for k in range(len(moved) - 1, -1, -1):
        moved[k] = min(moved[k], within - gap * (len(moved) - 1 - k))
    result = np.empty_like(moved)
    result[order] = moved
    return result
