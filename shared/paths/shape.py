"""How large, long and bent a drawing is, and the same drawing at another size or place."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import check_path, curvature, lengths, smoothed
from nufleet.shared.strict import NonNegative, Positive, Strict

_STRAIGHT = 1e-3
"""A path that turns by less than this over its whole length is a line."""


class DrawingShape(Strict):
    """What can be said of a drawing before anybody flies it, in m.

    `furthest_m` is the largest |x| or |y|, which a robot's workspace bounds. `tightest_radius_m` is
    that of the sharpest bend as it is travelled, after smoothing; None for a straight line.
    """

    points: int
    length_m: Positive
    width_m: NonNegative
    height_m: NonNegative
    furthest_m: Positive
    tightest_radius_m: Positive | None


def shape_of(points: FloatArray) -> DrawingShape:
    """Return the shape of a drawing, (n, 2); raises InvalidInputError unless it is a path."""
    check_path(points, "the drawing")
    path, along = smoothed(points)
    width, height = np.ptp(points, axis=0)
    sharpest = float(curvature(path, along).max())
    return DrawingShape(
        points=len(points),
        length_m=float(lengths(points)[-1]),
        width_m=float(width),
        height_m=float(height),
        furthest_m=float(np.abs(points).max()),
        tightest_radius_m=None if sharpest * along[-1] < _STRAIGHT else 1.0 / sharpest,
    )


def resized(
    points: FloatArray,
    *,
    width_m: float | None = None,
    height_m: float | None = None,
    centred: bool = False,
) -> FloatArray:
    """Return a drawing, (n, 2), scaled to a width or a height, its proportions kept, and moved.

    Args:
        points: of the drawing.
        width_m: of the result; None keeps the size, or lets `height_m` say it.
        height_m: likewise; at most one of the two.
        centred: puts the middle of its extent at the origin. Without it the origin stays.

    Raises:
        InvalidInputError: both sizes are given, or the drawing has none in that direction.
    """
    if width_m is not None and height_m is not None:
        raise InvalidInputError("give a width or a height: the other follows")
    width, height = np.ptp(points, axis=0)
    scale = 1.0
    for wanted, extent, name in ((width_m, width, "wide"), (height_m, height, "high")):
        if wanted is not None:
            if extent == 0:
                raise InvalidInputError(
                    f"the drawing is a line and not {name}: say its size in the other direction"
                )
            scale = wanted / float(extent)
    result = scale * points
    if centred:
        result = result - (result.min(axis=0) + result.max(axis=0)) / 2
    return np.asarray(result)


def resampled(points: FloatArray, spacing_m: float, *, count_min: int = 64) -> FloatArray:
    """Return a drawing, (n, 2), as evenly spaced points, at most `spacing_m` apart, its ends kept.

    What lies between two points is cut straight, which is less than smoothing does when it is
    travelled.
    """
    steps = np.any(np.diff(points, axis=0) != 0, axis=1)
    distinct = points[np.concatenate([[True], steps])]
    length = lengths(distinct)
    count = max(count_min, int(np.ceil(length[-1] / spacing_m)) + 1)
    even = np.linspace(0.0, length[-1], count)
    return np.stack([np.interp(even, length, column) for column in distinct.T], axis=1)
