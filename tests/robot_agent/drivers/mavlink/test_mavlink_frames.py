"""NED to ENU and back, once for all messages."""

from __future__ import annotations

import math

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from nufleet.robot_agent.drivers.mavlink.frames import enu_of_ned, rotated, yaw_of_other_frame

SIZES = st.floats(-100, 100)


@given(st.tuples(SIZES, SIZES, SIZES))
def test_north_east_down_become_east_north_up_and_come_back(ned: tuple[float, ...]) -> None:
    north, east, down = ned
    enu = enu_of_ned(np.array(ned))
    assert enu.tolist() == [east, north, -down]
    assert enu_of_ned(enu).tolist() == list(ned)


def test_the_map_keeps_hands_right() -> None:
    axes = np.eye(3)
    x, y, z = (enu_of_ned(axis) for axis in axes)
    assert np.cross(x, y).tolist() == z.tolist()


@given(st.floats(-3, 3))
def test_a_nose_that_points_somewhere_points_there_in_both_frames(yaw_ned_rad: float) -> None:
    nose_ned = np.array([math.cos(yaw_ned_rad), math.sin(yaw_ned_rad), 0.0])
    yaw = yaw_of_other_frame(yaw_ned_rad)
    np.testing.assert_allclose(
        enu_of_ned(nose_ned), [math.cos(yaw), math.sin(yaw), 0.0], atol=1e-12
    )


def test_the_velocity_of_a_body_is_turned_into_the_frame_of_its_attitude() -> None:
    nose_to_the_east = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    np.testing.assert_allclose(
        rotated(nose_to_the_east, np.array([2.0, 0.0, 1.0])), [0.0, 2.0, 1.0], atol=1e-12
    )
