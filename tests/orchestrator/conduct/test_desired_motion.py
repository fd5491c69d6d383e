"""The drawing that a ranking is for becomes a spectrum of the target's motion."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from random_loops import SPEC

from nufleet.orchestrator.conduct.desired_motion import (
    amplitude_of,
    axes_along,
    desired_motion,
    leg_of,
    read_motion,
)
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import RobotSpec, TrackingLimits
from nufleet.shared.wire.messages import Description

CIRCLE = np.exp(2j * np.pi * np.linspace(0.0, 1.0, 400))


@pytest.fixture
def circle(tmp_path: Path) -> Path:
    """A circle of radius 1 m."""
    path = tmp_path / "circle.csv"
    path.write_text("x_m,y_m\n" + "\n".join(f"{z.real},{z.imag}" for z in CIRCLE))
    return path


def test_most_of_a_circle_s_motion_is_at_its_angular_speed(circle: Path) -> None:
    motion = desired_motion(read_motion(str(circle), 0.5), SPEC, ("x",))
    assert motion.name == "circle at 0.5 m/s"
    power = np.array(motion.power)
    # Smoothing, and speeding up and down, take a little of the radius and of the turn.
    assert motion.omega_rad_s[int(np.argmax(power))] == pytest.approx(0.5, rel=0.1)
    assert power.sum() == pytest.approx(1.0, rel=0.1)
    assert amplitude_of(motion) == pytest.approx(1.0, rel=0.1), "its radius"


def test_without_a_speed_the_target_s_axis_says_how_fast(circle: Path) -> None:
    motion = desired_motion(read_motion(str(circle), None), SPEC, ("x",))
    assert motion.name == f"circle at {SPEC.axes[0].velocity_max:g} m/s"


def test_a_target_that_tracks_goes_no_faster_than_it_may_along_a_path(circle: Path) -> None:
    tracking = TrackingLimits(
        position_max=1.5,
        speed_max=0.4,
        acceleration_max=1.0,
        correction_max=0.5,
        correction_speed_max=1.0,
    )
    target = Description(
        robot="target", boot_id="b", spec=SPEC.model_copy(update={"tracking": tracking})
    )
    assert desired_motion(read_motion(str(circle), None), target.spec, ("x",)).name.endswith(
        "0.4 m/s"
    )
    assert leg_of(read_motion(str(circle), None), target).speed == 0.4
    with pytest.raises(InvalidInputError, match="choose a speed of at most"):
        leg_of(read_motion(str(circle), 0.5), target)


def test_an_axis_that_does_not_move_in_metres_is_refused(circle: Path) -> None:
    turning = SPEC.axes[0].model_copy(update={"unit": "rad"})
    spec = SPEC.model_copy(update={"axes": (turning,)})
    with pytest.raises(InvalidInputError, match=r"in m, and axis x .* rad"):
        desired_motion(read_motion(str(circle), 0.5), spec, ("x",))


def with_axes(**units: str) -> RobotSpec:
    (axis,) = SPEC.axes
    axes = (axis.model_copy(update={"name": n, "unit": unit}) for n, unit in units.items())
    return SPEC.model_copy(update={"axes": tuple(axes)})


def test_each_of_several_axes_has_the_power_of_its_own_motion(tmp_path: Path) -> None:
    path = tmp_path / "ellipse.csv"
    path.write_text("x_m,y_m\n" + "\n".join(f"{z.real},{0.5 * z.imag}" for z in CIRCLE))
    drawing, spec = read_motion(str(path), 0.5), with_axes(x="m", y="m", z="m")
    motion = desired_motion(drawing, spec, ("x", "y", "z"))
    along_x, along_y = (sum(motion.power_by_axis[axis]) for axis in "xy")
    assert "z" not in motion.power_by_axis
    assert along_x + along_y == pytest.approx(sum(motion.power))
    assert along_x == pytest.approx(4 * along_y, rel=0.25)
    assert amplitude_of(motion) == pytest.approx(1.0, rel=0.1), "the longer half axis"
    with pytest.raises(InvalidInputError, match="axes x, y of the target move along a drawing"):
        desired_motion(drawing, spec, ("x", "z"))


def test_the_axes_for_a_drawing_are_those_that_fly_it_where_all_robots_have_them(
    circle: Path,
) -> None:
    drawing = read_motion(str(circle), None)
    spec = with_axes(x="m", y="m", z="m")
    assert axes_along(drawing, spec, ("x", "y", "z")) == ("x", "y")
    assert axes_along(drawing, spec, ("x", "z")) == ("x",)
    assert axes_along(drawing, with_axes(x="m", yaw="rad"), ("x", "yaw")) == ("x",)


@pytest.mark.parametrize(
    ("text", "words"),
    [("x_m,y_m\n0,0\nnan,1\n", "not finite"), ("x_m,y_m\n0,0\n", "two different points")],
)
def test_a_drawing_that_is_no_path_is_refused(tmp_path: Path, text: str, words: str) -> None:
    path = tmp_path / "bad.csv"
    path.write_text(text)
    with pytest.raises(InvalidInputError, match=words):
        read_motion(str(path), 0.5)
