"""Reduces the number of points of a line without changing how it looks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray


def outline(values: FloatArray, points_max: int) -> NDArray[np.intp]:
    """Return the indices of at most `points_max` samples that draw the same line.

    The signal is divided into points_max / 2 equal stretches, and each keeps its lowest and its
    highest sample, so that no peak is lost. A signal that is short enough keeps all samples.

    Args:
        values: Samples of the signal in any unit, shape (n,).
        points_max: Limit on the number of samples, at least 2.

    Returns:
        Increasing indices, shape (≤ points_max,).
    """
    n = len(values)
    if n <= points_max:
        return np.arange(n)
    edges = np.linspace(0, n, points_max // 2 + 1).astype(int)
    begin, last = edges[:-1, np.newaxis], edges[1:, np.newaxis] - 1
    # One row of indices per stretch; shorter stretches repeat their last sample.
    rows = np.minimum(begin + np.arange(np.diff(edges).max(initial=1)), last)
    stretches = values[rows]
    ends = [stretches.argmin(axis=1), stretches.argmax(axis=1)]
    kept = [np.take_along_axis(rows, end[:, np.newaxis], axis=1).ravel() for end in ends]
    return np.unique(np.concatenate(kept))


def thinned(points: FloatArray, points_max: int) -> FloatArray:
    """Return at most `points_max` points that draw the same path.

    Both ends are kept, and the extremes of every axis in each stretch; see `outline`.

    Args:
        points: Points in the order in which the path passes them, shape (n, axes).
        points_max: Limit on the number of points, at least 2 + 2 · axes.

    Returns:
        The points that are kept, in the same order, shape (≤ points_max, axes).
    """
    n, axes = points.shape
    if n <= points_max:
        return points
    each = (points_max - 2) // axes // 2 * 2
    kept = [outline(points[:, axis], each) for axis in range(axes)]
    return np.asarray(points[np.unique(np.concatenate([[0, n - 1], *kept]))])
