"""References of flights without a drawing, computed alike by a robot and its orchestrator.

A rich flight excites a robot persistently, within its limits, and shows its dynamics; a step test
shows its delay; an approach leads from rest at the origin to the start of a path.
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.paths.trajectories import speeds_and_accelerations, travel
from nufleet.shared.robots.joint_limits import HEADROOM
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits

_PIECE_RAD = 15.0  # length in radians of the slowest piece's highest tone: 15 s at 1 rad/s
_FADE_RAD = 2.0  # length of the fade at either end of a piece, likewise
_PERIODS_MIN = 4  # of the highest tone, in a flight shorter than one piece
_PIECE_SAMPLES_MIN = 16
_PARTS = 4  # pieces that take turns: each reaches up to another part of the band
_OMEGA_MAX_RAD_S = 6.0  # drawings contain nothing faster
_TONES = 8
STEPS_UP_MIN, _STEPS_UP_MAX = 10, 20
_STEPS_S = 100.0  # more than `STEPS_UP_MIN` steps are played only if they fit into this time

SLOWEST = 0.05
"""Least speed of an approach, as a share of the largest that the robot may track at."""


def rich_references(spec: RobotSpec, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return references that excite every axis, from rest to rest.

    They consist of pieces, each a sum of eight sinusoids with random phases over a part of the
    robot's band. Slow pieces reach the limit on position or speed, fast ones the limit on
    acceleration. A piece lasts 15 s, and longer for a robot whose band ends below 2 rad/s. A
    shorter flight is one piece of its duration, but of at least four periods of the band's upper
    edge.

    Args:
        spec: Description of the robot, whose band and tracking limits the references keep to.
        duration_s: Shortest duration in seconds; beyond one piece, a robot flies whole pieces.
        rng: Generator of the frequencies, phases and weights.

    Returns:
        The references, shape (samples, axes), in the axes' units.

    Raises:
        RobotError: The robot has no tracking limits.
    """
    limits = spec.tracking
    if limits is None:
        raise RobotError("a robot without tracking limits cannot fly a rich flight")
    top = top_rad_s(spec)
    # A slower robot needs the same number of periods, hence longer pieces with softer ends, to stay
    # within its band.
    slow = min(1.0, top / 2)
    whole_s = _PIECE_RAD / slow
    piece_s = max(_PERIODS_MIN * 2 * math.pi / top, min(whole_s, duration_s))
    samples = max(_PIECE_SAMPLES_MIN, round(piece_s / spec.sample_time_s))
    pieces = math.ceil(duration_s / piece_s)
    highest = np.geomspace(min(max(slow, 3 * spec.omega_min_rad_s), top), top, _PARTS)
    # The fade of the highest piece reaches beyond the band; among few pieces that would show.
    first = max(0, _PARTS - 1 - pieces)
    return np.concatenate(
        [
            _piece(spec, limits, slow, float(highest[(first + i) % _PARTS]), samples, rng)
            for i in range(pieces)
        ]
    )


def top_rad_s(spec: RobotSpec) -> float:
    """Return the highest frequency in a robot's rich flights, in rad/s."""
    return min(spec.omega_max_rad_s, max(_OMEGA_MAX_RAD_S, 3 * spec.omega_min_rad_s))


def _piece(
    spec: RobotSpec,
    limits: TrackingLimits,
    slow_rad_s: float,
    highest_rad_s: float,
    samples: int,
    rng: np.random.Generator,
) -> FloatArray:
    """Return a piece, shape (samples, axes), scaled until it reaches one of the limits."""
    lowest_rad_s = max(spec.omega_min_rad_s, 0.3 * min(slow_rad_s, highest_rad_s))
    time_s: FloatArray = np.arange(samples, dtype=np.float64) * spec.sample_time_s
    fade = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) * slow_rad_s / _FADE_RAD)
    # Smoothstep 10 f³ − 15 f⁴ + 6 f⁵, whose first and second derivatives vanish at both ends: the
    # pieces join without a jump in speed or acceleration.
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    columns = [fade * _wave(lowest_rad_s, highest_rad_s, time_s, rng) for _ in spec.axes]
    waves = np.stack(columns, axis=1)
    waves /= np.abs(np.diff(waves, axis=0)).max(axis=0)  # every axis equally fast
    speeds, accelerations = speeds_and_accelerations(waves, spec.sample_time_s)
    largest = min(
        limits.position_max / np.abs(waves).max(),
        limits.speed_max / speeds.max(),
        limits.acceleration_max / accelerations.max(),
    )
    return np.asarray(waves * largest)


def _wave(
    lowest_rad_s: float, highest_rad_s: float, time_s: FloatArray, rng: np.random.Generator
) -> FloatArray:
    # Amplitudes fall with 1/ω, so that the tones are about equally fast.
    omegas = rng.uniform(lowest_rad_s, highest_rad_s, _TONES)
    phases = rng.uniform(0, 2 * np.pi, _TONES)
    weights = rng.uniform(0.5, 1.0, _TONES) / omegas
    return np.asarray(weights @ np.sin(np.outer(omegas, time_s) + phases[:, np.newaxis]))


def step_references(spec: RobotSpec, column: int) -> FloatArray:
    """Return steps up and down on one axis, from rest to rest.

    There are ten to twenty steps in each direction. Half of them are followed by a step in the same
    direction and half by one in the opposite direction, so that the remainder of one step cancels
    in the mean over the next ones. A step accelerates over the first half of its way and brakes
    over the second, as hard as the axis's limits allow, because noise would hide the answer to a
    smaller step. Like every amplitude that a robot chooses itself, it keeps the margin `HEADROOM`
    to the limits.

    Args:
        spec: Description of the robot.
        column: Index of the axis that steps; the other axes stay at 0.

    Returns:
        The references, shape (samples, axes), in the axes' units.
    """
    axis, step_s = spec.axes[column], spec.sample_time_s
    settle_s = max(spec.settling_time_s, 0.5)
    hold = max(4, math.ceil(settle_s / step_s))
    amplitude, velocity, acceleration = (
        HEADROOM * most for most in (axis.amplitude_max, axis.velocity_max, axis.acceleration_max)
    )
    # Accelerating at a for the time t and braking as long reaches the speed a t and covers a t²,
    # which the limits on velocity and amplitude bound.
    longest_s = min(settle_s / 4, velocity / acceleration, math.sqrt(amplitude / acceleration))
    half = max(1, math.floor(longest_s / step_s))
    # One sample at the largest acceleration may already exceed the other limits.
    acceleration = min(acceleration, velocity / (half * step_s), amplitude / (half * step_s) ** 2)
    velocities = acceleration * step_s * np.cumsum(np.repeat([1.0, -1.0], half))
    rise = np.pad(np.cumsum(velocities) * step_s, (0, hold), mode="edge")
    height = rise[-1]
    fours = int(_STEPS_S / (4 * len(rise) * step_s))
    fours = min(max(fours, STEPS_UP_MIN // 2), _STEPS_UP_MAX // 2)
    column_references = np.concatenate([rise, height - rise, -rise, rise - height] * fours)
    references = np.zeros((hold + len(column_references), len(spec.axes)))
    references[hold:, column] = column_references
    return references


def approach(spec: RobotSpec, path: FloatArray, limits: TrackingLimits) -> FloatArray:
    """Return the references that lead from the origin to a path's start and let the robot settle.

    They are no faster than the path: who flies it slowly wants to be near no faster motion.

    Args:
        spec: Description of the robot.
        path: Path, shape (samples, axes), in the axes' units.
        limits: Tracking limits of the robot; the approach uses at most half of the speed and
            acceleration, and at least `SLOWEST` of the speed, so that it ends.

    Returns:
        The references, shape (samples, axes), in the axes' units.
    """
    start = path[0]
    settle = np.tile(start, (max(1, math.ceil(spec.settling_time_s / spec.sample_time_s)), 1))
    if not start.any():
        return settle
    line = np.stack([np.zeros_like(start), start])
    speeds, _ = speeds_and_accelerations(path, spec.sample_time_s)
    speed = min(max(float(speeds.max()), SLOWEST * limits.speed_max), limits.speed_max / 2)
    way = travel(line, speed, limits.acceleration_max / 2, spec.sample_time_s)
    return np.concatenate([way, settle])
