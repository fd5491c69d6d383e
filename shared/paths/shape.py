"""The size, length and bends of a drawing, and the same drawing at another size or place."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import (
    POINTS_MAX,
    check_path,
    curvature,
    lengths,
    smoothed,
)
from nufleet.shared.strict import NonNegative, Positive, Strict

_STRAIGHT = 1e-3
"""A path that turns by less than this over its whole length is a line."""


class DrawingShape(Strict):
    """Properties of a drawing that are known before it is flown."""

    points: int
    """Number of points."""
    length_m: Positive
    """Length along the drawing."""
    width_m: NonNegative
    """Extent in x."""
    height_m: NonNegative
    """Extent in y."""
    furthest_m: Positive
    """Largest |x| or |y|, which a robot's workspace limits."""
    tightest_radius_m: Positive | None
    """Radius of the sharpest bend as it is travelled, after smoothing; None for a straight line."""


def shape_of(points: FloatArray) -> DrawingShape:
    """Return the shape of a drawing.

    Args:
        points: Points of the drawing in m, shape (n, 2).

    Raises:
        InvalidInputError: the points are not a path, see `check_path`.
    """
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
    """Return a drawing scaled to a width or a height, with its proportions kept, and moved.

    Args:
        points: Points of the drawing in m, shape (n, 2).
        width_m: Width of the result. At most one of width and height may be given; without either
            the size is kept.
        height_m: Height of the result.
        centred: True to move the middle of its extent to the origin; otherwise it is scaled about
            the origin.

    Returns:
        Points of the new drawing in m, shape (n, 2).

    Raises:
        InvalidInputError: both sizes are given, or the drawing has no extent in that direction.

    Examples:
        >>> corner = np.array([[0.0, 0.0], [1.0, 0.0], [1.0, 2.0]])
        >>> resized(corner, width_m=0.5)
        array([[0. , 0. ],
               [0.5, 0. ],
               [0.5, 1. ]])
    """
    if width_m is not None and height_m is not None:
        raise InvalidInputError("give either a width or a height: the other follows from it")
    width, height = np.ptp(points, axis=0)
    scale = 1.0
    for wanted, extent, name in ((width_m, width, "wide"), (height_m, height, "high")):
        if wanted is not None:
            if extent == 0:
                raise InvalidInputError(
                    f"the drawing is a line and not {name}: give its size in the other direction"
                )
            scale = wanted / float(extent)
    result = scale * points
    if centred:
        result = result - (result.min(axis=0) + result.max(axis=0)) / 2
    return np.asarray(result)


def resampled(points: FloatArray, spacing_m: float, *, count_min: int = 64) -> FloatArray:
    """Return a drawing as evenly spaced points, with its ends kept.

    Corners between the new points are cut by straight lines, which changes the drawing less than
    the smoothing does when it is travelled.

    Args:
        points: Points of the drawing in m, shape (n, 2).
        spacing_m: Largest distance between neighbouring points, along the drawing.
        count_min: Least number of points.

    Returns:
        Points of the new drawing in m, shape (count, 2).

    Raises:
        InvalidInputError: the drawing is too long for that distance between its points.
    """
    steps = np.any(np.diff(points, axis=0) != 0, axis=1)
    distinct = points[np.concatenate([[True], steps])]
    length = lengths(distinct)
    count = max(count_min, int(np.ceil(length[-1] / spacing_m)) + 1)
    if count > POINTS_MAX:
        raise InvalidInputError(
            f"the drawing is {length[-1]:.4g} m long and would have {count} points, more than "
            f"{POINTS_MAX}: is it in mm? Give its size in m with --height or --width"
        )
    even = np.linspace(0.0, length[-1], count)
    return np.stack([np.interp(even, length, column) for column in distinct.T], axis=1)
