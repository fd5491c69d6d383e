"""Drawings become paths that a robot can fly, or are refused with what to do."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots_that_learn import LIMITS, LaggedRobot, double_integrator

from nufleet.orchestrator.flights.legs import (
    Leg,
    legs_of,
    practice_path,
    read_drawings,
    tracking_limits,
    trajectory,
    typical_leg,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import check_trajectory
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.messages import Description

PLANE = LaggedRobot().spec
LINE = double_integrator().spec
TURN = np.linspace(0.0, 2 * np.pi, 200)
CIRCLE = np.stack([np.cos(TURN), np.sin(TURN)], axis=1)


def described(spec: RobotSpec = PLANE) -> Description:
    return Description(robot="drone-7", boot_id="b1", spec=spec)


def with_axes(*names: str) -> RobotSpec:
    axes = tuple(
        AxisSpec(name=name, unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=2.0)
        for name in names
    )
    return PLANE.model_copy(update={"axes": axes})


def drawing(folder: Path, name: str, points: FloatArray = CIRCLE) -> str:
    path = folder / name
    path.parent.mkdir(exist_ok=True)
    path.write_text("x_m,y_m\n" + "\n".join(f"{x},{y}" for x, y in points) + "\n")
    return str(path)


# One path.


@settings(max_examples=15, deadline=None)
@given(st.integers(0, 1000), st.floats(0.1, 1.0), st.sampled_from([("x",), ("x", "y"), "xyz"]))
def test_a_path_keeps_to_the_robots_limits_whatever_is_drawn(
    seed: int, speed: float, axes: tuple[str, ...]
) -> None:
    points = np.random.default_rng(seed).uniform(-1.4, 1.4, (8, 2))
    spec = with_axes(*axes)
    path = trajectory(points, speed, spec, "drone-7")
    check_trajectory(path, spec.sample_time_s, LIMITS)
    assert path.shape[1] == len(axes)
    np.testing.assert_allclose(path[[0, -1], : min(2, len(axes))], points[[0, -1], : len(axes)])


def test_a_robot_with_one_axis_follows_x_and_axes_beyond_two_stay_at_zero() -> None:
    alone, three = (trajectory(CIRCLE, 0.5, s, "r") for s in (LINE, with_axes("x", "y", "z")))
    assert alone.shape[1] == 1
    # Smoothing rounds a turn on the scale of 1.5 % of the extent.
    assert alone.min() == pytest.approx(-1.0, abs=0.03)
    assert alone.max() == pytest.approx(1.0, abs=0.03)
    assert not three[:, 2].any()


@pytest.mark.parametrize(
    ("points", "speed", "words"),
    [
        (2 * CIRCLE, 0.5, "outside the workspace of ±1.5 m.*at most 75 % as large"),
        (CIRCLE + 1.0, 0.5, "outside the workspace"),
        (CIRCLE, 1.5, "1.5 m/s is faster.*at most 1 m/s"),
        (CIRCLE, 1e-4, "too long: choose a higher speed"),
        (CIRCLE[:1], 0.5, "two different points"),
        (np.where(CIRCLE[7] == CIRCLE, np.nan, CIRCLE), 0.5, "is not finite|not finite"),
    ],
)
def test_a_drawing_that_cannot_be_flown_is_refused_with_the_robot_and_what_to_do(
    points: FloatArray, speed: float, words: str
) -> None:
    with pytest.raises(InvalidInputError, match=words) as raised:
        trajectory(points, speed, PLANE, "drone-7")
    assert "robot drone-7" in str(raised.value)


def test_a_drawing_across_the_only_axis_is_no_path() -> None:
    upright = np.stack([np.zeros(9), np.linspace(-1, 1, 9)], axis=1)
    with pytest.raises(InvalidInputError, match=r"drone-7 .*two different points"):
        trajectory(upright, 0.5, LINE, "drone-7")


def test_a_robot_without_tracking_limits_is_named() -> None:
    spec = PLANE.model_copy(update={"tracking": None})
    for ask in (lambda: tracking_limits(spec, "arm-1"), lambda: practice_path(spec, "arm-1")):
        with pytest.raises(InvalidInputError, match="robot arm-1 has no tracking limits"):
            ask()


def test_a_robot_whose_axes_have_several_units_is_told_that_it_flies_no_paths() -> None:
    x, y = PLANE.axes
    axes = (x, y.model_copy(update={"name": "yaw", "unit": "rad"}))
    spec = PLANE.model_copy(update={"axes": axes, "tracking": None})
    words = "robot drone-7 flies no paths, since its axes are in m and rad .* `nufleet rank`"
    with pytest.raises(InvalidInputError, match=words):
        tracking_limits(spec, "drone-7")


@pytest.mark.parametrize("spec", [PLANE, LINE, with_axes("x", "y", "z")])
def test_the_practice_path_uses_most_of_the_workspace_on_every_axis(spec: RobotSpec) -> None:
    limits = spec.tracking
    assert limits is not None
    path = practice_path(spec, "drone-7")
    check_trajectory(path, spec.sample_time_s, limits)
    assert (np.abs(path).max(axis=0) > 0.5 * limits.position_max).all()


# Several.


def test_every_drawing_is_flown_at_every_speed(tmp_path: Path) -> None:
    drawings = read_drawings([drawing(tmp_path, "a.csv"), drawing(tmp_path, "b.csv", CIRCLE / 2)])
    legs = legs_of(drawings, (0.3, 0.6), described())
    assert [(leg.drawing, leg.speed) for leg in legs] == [
        *(("a", 0.3), ("a", 0.6), ("b", 0.3), ("b", 0.6))
    ]
    assert len({leg.label("source-1") for leg in legs}) == 4
    assert legs[1].label("source-1") == "source-1 · a · 0.6 m/s"
    assert len(legs[1].desired) < len(legs[0].desired)


def test_a_scale_makes_a_drawing_larger_or_smaller() -> None:
    whole, half = (legs_of({"c": CIRCLE}, (0.5,), described(), scale=s)[0] for s in (1.0, 0.5))
    assert np.abs(half.desired).max() == pytest.approx(np.abs(whole.desired).max() / 2, rel=1e-3)


def test_an_installed_drawing_is_read_by_its_name() -> None:
    assert list(read_drawings(["clover"])) == ["clover"]


def test_flights_that_could_not_be_told_apart_are_refused(tmp_path: Path) -> None:
    first, second = drawing(tmp_path / "1", "a.csv"), drawing(tmp_path / "2", "a.csv")
    with pytest.raises(InvalidInputError, match="two drawings are called a"):
        read_drawings([first, second])
    with pytest.raises(InvalidInputError, match="a speed is named twice"):
        legs_of({"a": CIRCLE}, (0.3, 0.6, 0.3), described())


def test_of_many_drawings_the_one_that_cannot_be_flown_is_named() -> None:
    with pytest.raises(InvalidInputError, match=r"^large: robot drone-7 cannot fly it"):
        legs_of({"small": CIRCLE, "large": 3 * CIRCLE}, (0.5,), described())


def test_a_leg_of_a_joint_robot_is_in_rad() -> None:
    axes = tuple(axis.model_copy(update={"unit": "rad"}) for axis in PLANE.axes)
    (leg,) = legs_of({"c": CIRCLE}, (0.5,), described(PLANE.model_copy(update={"axes": axes})))
    assert isinstance(leg, Leg)
    assert leg.label("none") == "none · c · 0.5 rad/s"


@pytest.mark.parametrize("share", [0.05, 0.3, 1.0, 4.0])
def test_a_typical_leg_fits_into_any_workspace_and_into_a_few_seconds(share: float) -> None:
    tracking = LIMITS.model_copy(update={"position_max": share * LIMITS.position_max})
    target = described(PLANE.model_copy(update={"tracking": tracking}))
    leg = typical_leg(target)
    check_trajectory(leg.desired, PLANE.sample_time_s, tracking)
    assert np.abs(leg.desired).max() <= tracking.position_max
    assert len(leg.desired) * PLANE.sample_time_s < 20.0
    assert leg.speed <= tracking.speed_max
    assert 0.0 < leg.size <= tracking.position_max
    assert leg.title.startswith(f"{leg.drawing}, {100 * leg.scale:.0f} % as large, at ")


def test_a_path_says_how_long_and_how_far_it_leads() -> None:
    spec = LaggedRobot().spec
    desired = np.zeros((100, 2))
    desired[50, 1] = -0.75
    leg = Leg("clover", 0.6, "m", desired)
    seconds = 100 * spec.sample_time_s
    assert leg.extent_text(spec) == (
        f"clover at 0.6 m/s: {seconds:.1f} s, up to 0.75 m from the origin"
    )
