"""Where the labels of points stand, so that they cover neither one another nor the points."""

from __future__ import annotations

import numpy as np

from shared.arrays import FloatArray

_GAP = 5.0


def label_places(points: FloatArray, sizes: FloatArray, area: tuple[float, float]) -> FloatArray:
    """Return the lower left corner of each label, shape (n, 2).

    Each in turn takes, of places all around its point, the one that covers least.

    Args:
        points: in the units of the screen, shape (n, 2).
        sizes: widths and heights of the labels, shape (n, 2).
        area: width and height of what may be written on, from the origin on.
    """
    taken = np.empty((0, 4))
    marks = np.column_stack([points - _GAP / 2, points + _GAP / 2])
    corners = []
    for point, size in zip(points, sizes, strict=True):
        candidates = point + _around(size)
        boxes = np.column_stack([candidates, candidates + size])
        covered = _overlap(boxes, taken).sum(axis=1) + 2 * _overlap(boxes, marks).sum(axis=1)
        outside = np.maximum(-boxes[:, :2], 0).sum(axis=1)
        outside += np.maximum(boxes[:, 2:] - np.array(area), 0).sum(axis=1)
        # Of places that are equally free the nearest, which come first.
        far = 1e-3 * np.arange(len(candidates)) * size[1]
        best = int(np.argmin(covered + 1e3 * outside + far))
        taken = np.concatenate([taken, boxes[best : best + 1]])
        corners.append(candidates[best])
    return np.array(corners).reshape(-1, 2)


def _around(size: FloatArray) -> FloatArray:
    """Return the corners of labels beside, above and below a point, the best liked first."""
    width, height = size
    near = [(_GAP, 0.0), (-width - _GAP, 0.0), (-width / 2, height), (-width / 2, -height)]
    beside = [
        (x, step * height)
        for step in (0.7, -0.7, 1.5, -1.5, 2.4, -2.4, 3.4, -3.4)
        for x in (_GAP, -width - _GAP, 3 * _GAP, -width - 3 * _GAP)
    ]
    return np.asarray(np.array([*near, *beside]) - np.array([0.0, height / 2]))


def _overlap(boxes: FloatArray, others: FloatArray) -> FloatArray:
    """Return the areas that boxes (n, 4) have in common with others (m, 4), shape (n, m)."""
    low = np.maximum(boxes[:, np.newaxis, :2], others[np.newaxis, :, :2])
    high = np.minimum(boxes[:, np.newaxis, 2:], others[np.newaxis, :, 2:])
    return np.asarray(np.prod(np.maximum(high - low, 0.0), axis=2))
