"""A path becomes a trajectory that keeps to its bounds, or is refused."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import check_path, check_trajectory, travel
from nufleet.shared.robots.spec import TrackingLimits

STEP_S = 0.02
LIMITS = TrackingLimits(
    position_max=1.5,
    speed_max=1.0,
    acceleration_max=2.0,
    correction_max=0.5,
    correction_speed_max=0.6,
)


def speeds(path: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(path, axis=0), axis=1) / STEP_S)


def accelerations(path: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.norm(np.diff(path, 2, axis=0), axis=1) / STEP_S**2)


def test_a_straight_line_takes_the_time_of_a_trapezoid_and_the_rounding() -> None:
    speed, acceleration, length = 0.5, 1.0, 2.0
    path = travel(np.array([[0.0, 0.0], [length, 0.0]]), speed, acceleration, STEP_S)
    along = 0.94 * acceleration / math.sqrt(2)
    expected_s = length / speed + speed / along + 0.4
    assert len(path) * STEP_S == pytest.approx(expected_s, abs=0.1)
    assert speeds(path).max() == pytest.approx(speed, rel=1e-3)
    np.testing.assert_allclose(path[:, 1], 0.0, atol=1e-12)


def test_it_starts_and_ends_at_rest_on_the_ends_of_the_path() -> None:
    points = np.array([[0.3, -0.2], [0.5, 0.4], [-0.6, 0.1]])
    path = travel(points, 0.6, 1.5, STEP_S)
    np.testing.assert_allclose(path[[0, -1]], points[[0, -1]], atol=1e-9)
    assert speeds(path)[[0, -1]].max() < 0.01


def test_a_circle_slows_down_to_what_the_acceleration_allows() -> None:
    angle = np.linspace(0, 4 * np.pi, 400)
    circle = 0.2 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    path = travel(circle, 5.0, 1.0, STEP_S)
    middle = speeds(path)[len(path) // 3 : 2 * len(path) // 3]
    assert np.median(middle) == pytest.approx(math.sqrt(0.2 * 0.94 / math.sqrt(2)), rel=0.05)


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000), st.integers(2, 12), st.floats(0.1, 2.0), st.floats(0.3, 4.0))
def test_no_path_breaks_its_bounds(seed: int, count: int, speed: float, most: float) -> None:
    points = np.random.default_rng(seed).uniform(-1, 1, (count, 2))
    path = travel(points, speed, most, STEP_S)
    assert speeds(path).max() <= 1.001 * speed
    assert accelerations(path).max() <= 1.02 * most
    assert np.abs(path).max() <= 1.05


def test_points_that_repeat_do_not_change_the_trajectory() -> None:
    points = np.array([[0.0, 0.0], [0.4, 0.3], [0.9, -0.2]])
    np.testing.assert_allclose(
        travel(np.repeat(points, 3, axis=0), 0.5, 1.0, STEP_S), travel(points, 0.5, 1.0, STEP_S)
    )


@pytest.mark.parametrize(
    ("points", "message"),
    [
        (np.zeros((1, 2)), "two different points"),
        (np.zeros((5, 2)), "two different points"),
        (np.array([[0.0, 0.0], [np.nan, 1.0]]), "point 2 contains a number that is not finite"),
        (np.zeros(4), "one row per point"),
        (np.zeros((100_001, 2)), "at most 100000 points"),
    ],
)
def test_what_is_not_a_path_is_refused(points: FloatArray, message: str) -> None:
    with pytest.raises(InvalidInputError, match=message):
        check_path(points, "it")


@pytest.mark.parametrize(
    ("speed", "most"), [(0.0, 1.0), (math.inf, 1.0), (math.nan, 1.0), (1.0, -1)]
)
def test_a_speed_that_cannot_be_flown_is_refused(speed: float, most: float) -> None:
    with pytest.raises(InvalidInputError, match="must be positive"):
        travel(np.array([[0.0], [1.0]]), speed, most, STEP_S)


def test_a_path_that_takes_half_an_hour_is_refused() -> None:
    with pytest.raises(InvalidInputError, match="too long"):
        travel(np.array([[0.0], [1.0]]), 1e-4, 1.0, STEP_S)


def test_a_trajectory_within_the_limits_passes() -> None:
    check_trajectory(travel(np.array([[0.0], [1.5]]), 1.0, 2.0, STEP_S), STEP_S, LIMITS)


@pytest.mark.parametrize(
    ("end", "speed", "acceleration", "message"),
    [
        (1.6, 0.5, 1.0, "outside the workspace of ±1.5"),
        (1.2, 1.2, 2.0, "speed is 1.1"),
        (1.2, 1.0, 4.0, "acceleration is 2"),
    ],
)
def test_a_trajectory_beyond_the_limits_is_refused(
    end: float, speed: float, acceleration: float, message: str
) -> None:
    path = travel(np.array([[0.0], [end]]), speed, acceleration, STEP_S)
    with pytest.raises(InvalidInputError, match=message):
        check_trajectory(path, STEP_S, LIMITS)


def test_a_trajectory_that_begins_or_ends_in_full_motion_is_refused() -> None:
    """The robot rests before and after it, so at 0.95 unit/s the first sample alone asks 47."""
    line = np.arange(0.0, 1.0, 0.95 * STEP_S)[:, np.newaxis]
    from_rest = travel(np.array([[0.0], [1.4]]), 0.95, 2.0, STEP_S)
    fastest = int(np.argmax(np.diff(from_rest[:, 0])))
    for path in (line, line[:2], from_rest[fastest:], from_rest[: fastest + 1]):
        with pytest.raises(InvalidInputError, match=r"acceleration is .* begin and end at rest"):
            check_trajectory(path, STEP_S, LIMITS)
    check_trajectory(from_rest, STEP_S, LIMITS)
