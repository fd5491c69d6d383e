"""Fewer points that draw the same line."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray


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
    begin, last = edges[:-1, np.newaxis], edges[1:, np.newaxis] - 1
    # A row for each stretch; shorter ones repeat their last sample.
    rows = np.minimum(begin + np.arange(np.diff(edges).max(initial=1)), last)
    stretches = values[rows]
    ends = [stretches.argmin(axis=1), stretches.argmax(axis=1)]
    kept = [np.take_along_axis(rows, end[:, np.newaxis], axis=1).ravel() for end in ends]
    return np.unique(np.concatenate(kept))


def thinned(points: FloatArray, points_max: int) -> FloatArray:
    """Return at most `points_max` points, shape (≤ points_max, axes), that draw the same path.

    The extremes of every axis are kept, stretch by stretch, and both ends.

    Args:
        points: in the order in which the path passes them, shape (n, axes).
        points_max: at least 2 + 2 · axes.
    """
    n, axes = points.shape
    if n <= points_max:
        return points
    each = (points_max - 2) // axes // 2 * 2
    kept = [outline(points[:, axis], each) for axis in range(axes)]
    return np.asarray(points[np.unique(np.concatenate([[0, n - 1], *kept]))])
