"""The shape of a drawing against closed forms, and drawings at other sizes and places."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.shape import resampled, resized, shape_of
from nufleet.shared.paths.trajectories import lengths

TURN = np.linspace(0.0, 2 * np.pi, 721)


def ellipse(a: float, b: float) -> FloatArray:
    return np.stack([a * np.cos(TURN), b * np.sin(TURN)], axis=1)


def test_a_circle_is_as_long_wide_and_bent_as_its_radius_says() -> None:
    shape = shape_of(ellipse(0.5, 0.5) + np.array([0.3, 0.0]))
    assert shape.length_m == pytest.approx(np.pi, rel=1e-4)
    assert (shape.width_m, shape.height_m) == pytest.approx((1.0, 1.0))
    assert shape.furthest_m == pytest.approx(0.8)
    # Smoothing tightens a circle by a little, and bends its two ends.
    assert shape.tightest_radius_m == pytest.approx(0.5, rel=0.1)
    assert shape.points == len(TURN)


def test_the_tightest_curve_of_an_ellipse_is_at_its_narrow_ends() -> None:
    """Its radius is b²/a there."""
    open_ends = np.roll(ellipse(1.0, 0.6)[:-1], 180, axis=0)
    assert shape_of(open_ends).tightest_radius_m == pytest.approx(0.36, rel=0.1)


def test_a_line_is_straight() -> None:
    shape = shape_of(np.array([[0.0, 0.0], [3.0, 4.0]]))
    assert shape.length_m == pytest.approx(5.0)
    assert shape.tightest_radius_m is None
    assert shape_of(np.array([[0.0, 1.0], [2.0, 1.0]])).height_m == 0.0


def test_what_is_no_path_has_no_shape() -> None:
    with pytest.raises(InvalidInputError, match="two different points"):
        shape_of(np.zeros((3, 2)))


@given(st.floats(0.01, 100.0), st.floats(-5, 5), st.floats(-5, 5), st.booleans())
def test_a_drawing_gets_the_size_that_is_asked_for_and_keeps_its_proportions(
    size_m: float, x: float, y: float, centred: bool
) -> None:
    drawn = ellipse(2.0, 0.5) + np.array([x, y])
    high = resized(drawn, height_m=size_m, centred=centred)
    wide = resized(drawn, width_m=size_m, centred=centred)
    assert np.ptp(high, axis=0) == pytest.approx((4.0 * size_m, size_m))
    assert np.ptp(wide, axis=0) == pytest.approx((size_m, size_m / 4.0))
    if centred:
        np.testing.assert_allclose(high.min(axis=0), -high.max(axis=0), atol=1e-9 * size_m)


def test_without_a_size_nothing_changes_and_the_origin_stays() -> None:
    drawn = ellipse(1.0, 0.5) + np.array([0.2, 0.1])
    np.testing.assert_array_equal(resized(drawn), drawn)
    np.testing.assert_allclose(resized(drawn, height_m=2.0), 2.0 * drawn)


def test_a_line_has_a_size_in_one_direction_only() -> None:
    line = np.array([[0.0, 1.0], [2.0, 1.0]])
    np.testing.assert_allclose(np.ptp(resized(line, width_m=1.0), axis=0), [1.0, 0.0])
    with pytest.raises(InvalidInputError, match="not high"):
        resized(line, height_m=1.0)
    with pytest.raises(InvalidInputError, match="a width or a height"):
        resized(line, height_m=1.0, width_m=1.0)


@given(st.floats(0.005, 0.5), st.integers(0, 1000))
def test_points_are_evenly_spaced_along_the_drawing_and_keep_its_ends(
    spacing_m: float, seed: int
) -> None:
    drawn = np.random.default_rng(seed).uniform(-1, 1, (6, 2))
    even = resampled(np.repeat(drawn, 2, axis=0), spacing_m)
    np.testing.assert_allclose(even[[0, -1]], drawn[[0, -1]])
    apart = lengths(drawn)[-1] / (len(even) - 1)
    assert apart <= spacing_m * (1 + 1e-9)
    # Never further, and at a corner less.
    steps = np.linalg.norm(np.diff(even, axis=0), axis=1)
    assert steps.max() <= apart * (1 + 1e-9)
    assert lengths(even)[-1] <= lengths(drawn)[-1] * (1 + 1e-9)
