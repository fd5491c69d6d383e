"""Timing of a drawn path: as fast as bounds on speed and acceleration allow, smoothly."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import TrackingLimits

POINTS_MAX = 100_000
"""Largest number of points of a path, and of samples of a trajectory: half an hour at 50 Hz."""

# Distance between the points at which curvature is computed, as a fraction of the path's extent.
_SPACING_SHARE = 5e-4
# Scale on which a hand's tremor and a polygon's corners are smoothed, as a fraction of the extent.
_SMOOTHING_SHARE = 0.015
# Fraction of the acceleration that is used, because curvature is computed from differences.
_MARGIN = 0.94
# Time over which acceleration fades in and out.
_ROUNDING_S = 0.4


def check_path(points: FloatArray, name: str) -> None:
    """Check that points are a path: finite, not too many, and at least two of them different.

    Args:
        points: Points in any unit, shape (n, axes).
        name: Name of the path or its file, for error messages.

    Raises:
        InvalidInputError: the points are not a path; the message says why.
    """
    if points.ndim != 2 or points.shape[1] < 1:
        raise InvalidInputError(f"{name}: a path has one row per point, got shape {points.shape}")
    if len(points) > POINTS_MAX:
        raise InvalidInputError(f"{name}: at most {POINTS_MAX} points, got {len(points)}")
    if not np.isfinite(points).all():
        row = int(np.argmin(np.isfinite(points).all(axis=1)))
        raise InvalidInputError(f"{name}: point {row + 1} contains a number that is not finite")
    if len(points) < 2 or not (points != points[0]).any():
        raise InvalidInputError(f"{name}: a path needs at least two different points")


def check_trajectory(desired: FloatArray, sample_time_s: float, limits: TrackingLimits) -> None:
    """Refuse a trajectory that leaves the workspace or is faster than the robot may go.

    The robot rests at the first point before the trajectory begins and at the last point after it
    has ended, so the transitions from and to rest are checked too.

    Args:
        desired: Positions in the axes' unit, shape (samples, axes).
        sample_time_s: Time between samples.
        limits: Limits of the robot; speed and acceleration may exceed them by 2 %, since they are
            computed from differences of samples.

    Raises:
        InvalidInputError: a limit is exceeded; the message says which, where and by how much.
    """
    check_path(desired, "the trajectory")
    furthest = float(np.abs(desired).max())
    if furthest > (1 + 1e-9) * limits.position_max:
        raise InvalidInputError(
            f"the trajectory reaches {furthest:.3g} from the origin, outside the workspace of "
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
    """Return the norms of first and second difference quotients, with rest before and after.

    Args:
        positions: Positions in the axes' unit, shape (samples, axes). The motion is taken to be at
            rest at the first one before it and at the last one after it.
        sample_time_s: Time between samples.

    Returns:
        Speeds towards each sample and away from the last one, in unit/s, shape (samples + 1,), and
        accelerations at each sample, in unit/s², shape (samples,).
    """
    padded = np.pad(positions, ((1, 1), (0, 0)), mode="edge")
    speeds = np.linalg.norm(np.diff(padded, axis=0), axis=1) / sample_time_s
    accelerations = np.linalg.norm(np.diff(padded, 2, axis=0), axis=1) / sample_time_s**2
    return speeds, accelerations


def travel(
    points: FloatArray, speed: float, acceleration_max: float, sample_time_s: float
) -> FloatArray:
    """Return a trajectory along a path from rest to rest, at `speed` except where bends forbid it.

    Tremor and corners are smoothed on a scale of 1.5 % of the path's extent. The speed is the
    largest that respects both bounds, found by one pass forwards and one backwards along the path
    (Bobrow, Dubowsky & Gibson 1985, for a point mass). A moving average over 0.4 s then rounds the
    acceleration; being an average, it can violate neither bound.

    Args:
        points: Points of the path in the axes' unit, shape (n, axes).
        speed: Largest speed along the path, in unit/s.
        acceleration_max: Largest acceleration (Euclidean norm), in unit/s².
        sample_time_s: Time between samples of the result.

    Returns:
        Positions in the axes' unit, shape (samples, axes).

    Raises:
        InvalidInputError: the points are not a path, the speed or acceleration is not positive, or
            the trajectory would take too long.

    Examples:
        A straight line of 1 m, at 0.5 m/s and with 1 m/s² at most, for a robot that runs at 50 Hz:

        >>> desired = travel(np.array([[0.0, 0.0], [1.0, 0.0]]), 0.5, 1.0, 0.02)
        >>> desired[0], desired[-1]
        (array([0., 0.]), array([1., 0.]))
        >>> round(float(np.abs(np.diff(desired, axis=0)).max()) / 0.02, 3)
        0.5
    """
    check_path(points, "the path")
    if not (0 < speed < math.inf and 0 < acceleration_max < math.inf):
        raise InvalidInputError(f"speed and acceleration must be positive, got {speed}")
    path, along = smoothed(points)
    # Accelerations along and across the path add as squares, so each may use 1/√2 of the bound.
    time_s = _arrival(path, along, speed, _MARGIN * acceleration_max / math.sqrt(2))
    if time_s[-1] / sample_time_s > POINTS_MAX:
        raise InvalidInputError(
            f"at {speed:g} the path takes {time_s[-1]:.0f} s, which is too long: choose a higher "
            "speed"
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
        points: Points of a path that passes `check_path`, shape (n, axes).

    Returns:
        Many evenly spaced points, shape (m, axes), and the distance of each along the path, shape
        (m,), both in the points' unit.
    """
    path = _without_tremor(points)
    length = lengths(path)
    along = np.linspace(0.0, length[-1], len(path))
    return _interpolated(along, length, path), along


def lengths(points: FloatArray) -> FloatArray:
    """Return the distance of each point along a path, from 0 at the first.

    Args:
        points: Points in any unit, shape (n, axes).

    Returns:
        Distances in the same unit, shape (n,).
    """
    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    return np.concatenate([[0.0], np.cumsum(steps)])


def curvature(path: FloatArray, along: FloatArray) -> FloatArray:
    """Return the curvature, one over the radius, at each point of a smoothed path.

    Args:
        path: Evenly spaced points as returned by `smoothed`, shape (m, axes).
        along: Distance of each along the path, shape (m,).

    Returns:
        Curvatures in 1/unit, shape (m,).
    """
    step = along[1] - along[0]
    tangent = np.gradient(path, step, axis=0)
    return np.asarray(np.linalg.norm(np.gradient(tangent, step, axis=0), axis=1))


def _without_tremor(points: FloatArray) -> FloatArray:
    # Agents only check trajectories, and do without a third of a second of loading.
    from scipy.ndimage import gaussian_filter1d

    steps = np.linalg.norm(np.diff(points, axis=0), axis=1)
    distinct = np.concatenate([[True], steps > 0])
    points, steps = points[distinct], steps[steps > 0]
    length = np.concatenate([[0.0], np.cumsum(steps)])
    extent = float(np.linalg.norm(np.ptp(points, axis=0)))
    count = min(POINTS_MAX, max(64, math.ceil(length[-1] / (extent * _SPACING_SHARE)) + 1))
    even = _interpolated(np.linspace(0.0, length[-1], count), length, points)
    scale = _SMOOTHING_SHARE * extent / (length[-1] / (count - 1))
    # An odd reflection at both ends keeps the end points in place.
    margin = min(count - 1, math.ceil(4 * scale))
    padded = np.pad(even, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth = gaussian_filter1d(padded, scale, axis=0, mode="nearest")
    return np.asarray(smooth[margin : margin + count], dtype=np.float64)


def _arrival(path: FloatArray, along: FloatArray, speed: float, acceleration: float) -> FloatArray:
    """Return the time at which each point is reached, with bounded acceleration along and across.

    Across the path the bound limits the speed to v² ≤ a / curvature; along it, v² changes by at
    most 2 a Δs from point to point.
    """
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
