"""The way to the start of a path."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from robots_that_learn import LIMITS, LaggedRobot

from nufleet.shared.paths.references import SLOWEST, approach
from nufleet.shared.paths.trajectories import speeds_and_accelerations, travel

SPEC = LaggedRobot().spec
STEP_S = SPEC.sample_time_s


@given(speed=st.floats(1e-6, 1.0), start=st.floats(0.1, 1.5))
def test_it_is_no_faster_than_the_path_and_ends_at_its_start(speed: float, start: float) -> None:
    corners = np.array([[start, 0.0], [start + 20 * STEP_S * speed, 0.0]])
    path = travel(corners, speed, LIMITS.acceleration_max, STEP_S)
    way = approach(SPEC, path, LIMITS)
    fastest = speeds_and_accelerations(path, STEP_S)[0].max()
    speeds, accelerations = speeds_and_accelerations(np.vstack([np.zeros((1, 2)), way]), STEP_S)
    slowest = SLOWEST * LIMITS.speed_max
    assert speeds.max() <= min(max(fastest, slowest), LIMITS.speed_max / 2) * (1 + 1e-6)
    assert accelerations.max() <= LIMITS.acceleration_max / 2 * (1 + 1e-6)
    np.testing.assert_array_equal(way[-1], path[0])
    assert len(way) * STEP_S <= start / slowest + 3.0


def test_to_a_path_that_begins_at_the_origin_there_is_none_but_the_robot_settles() -> None:
    way = approach(SPEC, np.zeros((5, 2)), LIMITS)
    assert len(way) * STEP_S == pytest.approx(SPEC.settling_time_s)
    assert not way.any()
