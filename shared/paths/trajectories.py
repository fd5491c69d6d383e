"""Time along a drawn path: as fast as bounds on speed and acceleration allow, smoothly."""

from __future__ import annotations

import math

import numpy as np
from scipy.ndimage import gaussian_filter1d

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import TrackingLimits

POINTS_MAX = 100_000
"""Points of a path, and samples of a trajectory; half an hour at 50 samples per second."""

_SPACING_SHARE = 5e-4  # of the path's extent, between the points that curvature is computed at
_SMOOTHING_SHARE = 0.015  # of the path's extent: what a hand's tremor and a polygon's corners lose
_MARGIN = 0.94  # of the acceleration: curvature is computed from differences
_ROUNDING_S = 0.4  # over which acceleration fades in and out


def check_path(points: FloatArray, name: str) -> None:
    """Raise InvalidInputError unless `points`, (n, axes), are finite and at least two differ."""
    if points.ndim != 2 or points.shape[1] < 1:
        raise InvalidInputError(f"{name}: a path has one row per point, got shape {points.shape}")
    if len(points) > POINTS_MAX:
        raise InvalidInputError(f"{name}: at most {POINTS_MAX} points, got {len(points)}")
    if not np.isfinite(points).all():
        row = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InvalidInputError(f"{name}: point {row + 1} holds a number that is not finite")
    if len(points) < 2 or not (points != points[0]).any():
        raise InvalidInputError(f"{name}: a path needs at least two different points")


def check_trajectory(desired: FloatArray, sample_time_s: float, limits: TrackingLimits) -> None:
    """Refuse a trajectory that leaves the workspace or is faster than the robot may go.

    The robot rests at the trajectory's first point before it and at its last point after it, so
    the way out of rest and back to it counts too.

    Args:
        desired: shape (samples, axes).
        sample_time_s: between two samples.
        limits: what is allowed; 2 % are granted to differences of samples.

    Raises:
        InvalidInputError: says which bound is broken, where and by how much.
    """
    check_path(desired, "the trajectory")
    furthest = float(np.abs(desired).max())
    if furthest > (1 + 1e-9) * limits.position_max:
        raise InvalidInputError(
            f"the trajectory goes {furthest:.3g} from the origin, outside the workspace of "
            f"±{limits.position_max:g}"
        )
    speeds, accelerations = speeds_and_accelerations(desired, sample_time_s)
    for what, values, most in (
        ("speed", speeds, limits.speed_max),
        ("acceleration", accelerations, limits.acceleration_max),
    ):
        if float(values.max()) > 1.02 * most:
            at = int(np.argmax(values))
            rest = "" if 0 < at < len(values) - 1 else "; it has to begin and end at rest"
            raise InvalidInputError(
                f"the trajectory's {what} is {values.max():.3g} at {at * sample_time_s:.2f} s, "
                f"the limit is {most:g}{rest}"
            )


def speeds_and_accelerations(
    positions: FloatArray, sample_time_s: float
) -> tuple[FloatArray, FloatArray]:
    """Return the norms of first and second difference quotients between two rests.

    Args:
        positions: shape (samples, axes); at rest at the first before, at the last afterwards.
        sample_time_s: between two samples.

    Returns:
        Speeds on the way to each sample and from the last one, shape (samples + 1,), and
        accelerations at each sample, shape (samples,).
    """
    padded = np.pad(positions, ((1, 1), (0, 0)), mode="edge")
    speeds = np.linalg.norm(np.diff(padded, axis=0), axis=1) / sample_time_s
    accelerations = np.linalg.norm(np.diff(padded, 2, axis=0), axis=1) / sample_time_s**2
    return speeds, accelerations


def travel(
    points: FloatArray, speed: float, acceleration_max: float, sample_time_s: float
) -> FloatArray:
    """Move along a path from rest to rest, at `speed` wherever its bends allow it.

    Tremor and corners are smoothed on the scale of 1.5 % of the path's extent. The speed is the
    largest that respects both bounds, found by a pass forwards and one backwards along the path
    (Bobrow, Dubowsky & Gibson 1985, for a point mass); a moving average over 0.4 s then rounds the
    acceleration, and as an average it can break neither bound.

    Args:
        points: shape (n, axes).
        speed: the largest on the path, in unit/s.
        acceleration_max: in unit/s².
        sample_time_s: between two samples of the result.

    Returns:
        Positions, shape (samples, axes).

    Raises:
        InvalidInputError: not a path, or a speed or acceleration that is not positive.
    """
    check_path(points, "the path")
    if not (0 < speed < math.inf and 0 < acceleration_max < math.inf):
        raise InvalidInputError(f"speed and acceleration must be positive, got {speed}")
    path, along = smoothed(points)
    time_s = _arrival(path, along, speed, _MARGIN * acceleration_max / math.sqrt(2))
    if time_s[-1] / sample_time_s > POINTS_MAX:
        raise InvalidInputError(
            f"at {speed:g} the path takes {time_s[-1]:.0f} s, too long: choose a higher speed"
        )
    samples = math.ceil(time_s[-1] / sample_time_s) + 1
    travelled = _interpolated(np.arange(samples) * sample_time_s, time_s, path)
    half = max(1, round(_ROUNDING_S / 2 / sample_time_s))
    kernel = np.hanning(2 * half + 3)[1:-1]
    padded = np.pad(travelled, ((2 * half, 2 * half), (0, 0)), mode="edge")
    return np.stack(
        [np.convolve(column, kernel / kernel.sum(), mode="valid") for column in padded.T], axis=1
    )


def smoothed(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return a path as it is travelled: tremor and corners smoothed, its ends kept.

    Args:
        points: shape (n, axes), a path by `check_path`.

    Returns:
        Many evenly spaced points, shape (m, axes), and how far along the path each lies, (m,).
    """
    path = _without_tremor(points)
    length = lengths(path)
    along = np.linspace(0.0, length[-1], len(path))
    return _interpolated(along, length, path), along


def lengths(points: FloatArray) -> FloatArray:
    """Return how far along a path (n, axes) each of its points lies, shape (n,)."""
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def curvature(path: FloatArray, along: FloatArray) -> FloatArray:
    """Return one over the radius at each of the points that `smoothed` gives, shape (m,)."""
    step = along[1] - along[0]
    tangent = np.gradient(path, step, axis=0)
    return np.asarray(np.linalg.norm(np.gradient(tangent, step, axis=0), axis=1))


def _without_tremor(points: FloatArray) -> FloatArray:
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    distinct = np.concatenate([[True], steps > 0])
    points, steps = points[distinct], steps[steps > 0]
    length = np.concatenate([[0.0], np.cumsum(steps)])
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    count = min(POINTS_MAX, max(64, math.ceil(length[-1] / (extent * _SPACING_SHARE)) + 1))
    even = _interpolated(np.linspace(0.0, length[-1], count), length, points)
    scale = _SMOOTHING_SHARE * extent / (length[-1] / (count - 1))
    # An odd reflection at the ends keeps them where they are.
    margin = min(count - 1, math.ceil(4 * scale))
    padded = np.pad(even, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, scale, axis=0, mode="nearest")
    return np.asarray(smooth[margin : margin + count], dtype=np.float64)


def _arrival(path: FloatArray, along: FloatArray, speed: float, acceleration: float) -> FloatArray:
    """Return when each point of the path is reached, at most `acceleration` along and across it."""
    step = along[1] - along[0]
    square = np.minimum(speed**2, acceleration / np.maximum(curvature(path, along), 1e-12))
    square[0] = square[-1] = 0.0
    gain = 2 * acceleration * step
    for i in range(1, len(square)):
        square[i] = min(square[i], square[i - 1] + gain)
    for i in range(len(square) - 2, -1, -1):
        square[i] = min(square[i], square[i + 1] + gain)
    speeds = np.sqrt(square)
    return np.concatenate([[0.0], np.cumsum(2 * step / (speeds[:-1] + speeds[1:]))])


def _interpolated(at: FloatArray, knots: FloatArray, values: FloatArray) -> FloatArray:
    return np.stack([np.interp(at, knots, column) for column in values.T], axis=1)
