"""What is refused before any robot moves, and in which words."""

from __future__ import annotations

from dataclasses import replace

import pytest

from nufleet.orchestrator.conduct.preflight import (
    axes_left_out,
    check_band,
    check_names,
    check_plan,
    chosen_axes,
)
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.messages import Description


def describe(robot: str, *, axis: str = "x", unit: str = "m", low: float = 0.1) -> Description:
    axis_spec = AxisSpec.model_validate(
        {
            "name": axis,
            "unit": unit,
            "amplitude_max": 1.0,
            "velocity_max": 1.0,
            "acceleration_max": 1.0,
        }
    )
    spec = RobotSpec(
        kind="test",
        axes=(axis_spec,),
        sample_time_s=0.01,
        omega_min_rad_s=low,
        omega_max_rad_s=10.0,
        duration_max_s=600.0,
        settling_time_s=1.0,
        simulated=True,
    )
    return Description(robot=robot, boot_id="boot", spec=spec)


def plan(low: float = 0.5, high: float = 5.0) -> StudyPlan:
    return StudyPlan("target", ("source",), (low, high), 7, "x")


def test_a_plan_that_every_robot_can_carry_out_passes() -> None:
    check_plan(plan(), {"target": describe("target"), "source": describe("source")})


@pytest.mark.parametrize(
    ("low", "high", "words"),
    [
        (0.0, 5.0, "period is infinite"),
        (-1.0, 5.0, "above 0 rad/s"),
        (5.0, 0.5, "reversed"),
        (5.0, 5.0, "empty"),
        (float("nan"), 5.0, "finite"),
        (1.0, float("inf"), "finite"),
    ],
)
def test_a_band_that_cannot_be_tested_is_explained(low: float, high: float, words: str) -> None:
    with pytest.raises(InvalidInputError, match=words):
        check_band((low, high))


def test_a_band_outside_one_robots_limits_names_the_robot_and_its_band() -> None:
    fleet = {"target": describe("target"), "source": describe("source", low=1.0)}
    with pytest.raises(InvalidInputError, match=r"robot source .* 1 to 10 rad/s"):
        check_plan(plan(), fleet)


def test_a_robot_without_the_axis_is_named_with_the_axes_it_has() -> None:
    fleet = {"target": describe("target"), "source": describe("source", axis="y")}
    with pytest.raises(InvalidInputError, match=r"source has no axis 'x'; it has y"):
        check_plan(plan(), fleet)


def test_axes_in_different_units_are_not_compared() -> None:
    fleet = {"target": describe("target"), "source": describe("source", unit="rad")}
    with pytest.raises(
        InvalidInputError, match=r"source is in rad, that of the target target in m"
    ):
        check_plan(plan(), fleet)


@pytest.mark.parametrize(
    ("target", "sources", "words"),
    [
        ("nobody", ("a",), r"no robot 'nobody' .* a, b"),
        ("a", ("c",), "no robot 'c'"),
        ("a", ("a", "b"), "among the sources"),
        ("a", ("b", "b"), "named twice"),
        ("a", (), "no source"),
    ],
)
def test_names_that_cannot_be_right_are_refused(
    target: str, sources: tuple[str, ...], words: str
) -> None:
    with pytest.raises(InvalidInputError, match=words):
        check_names(target, sources, ("a", "b"))


def several(robot: str, **units: str) -> Description:
    one = describe(robot)
    axes = tuple(
        one.spec.axes[0].model_copy(update={"name": name, "unit": unit})
        for name, unit in units.items()
    )
    return one.model_copy(update={"spec": one.spec.model_copy(update={"axes": axes})})


def test_the_axes_are_those_requested_all_that_the_target_has_or_its_first() -> None:
    target = several("target", x="m", y="m", yaw="rad")
    assert chosen_axes(None, target) == ("x",)
    assert chosen_axes(("all",), target) == ("x", "y", "yaw")
    assert chosen_axes(("yaw", "x"), target) == ("yaw", "x")
    with pytest.raises(InvalidInputError, match="twice"):
        chosen_axes(("x", "x"), target)


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ({"x": "m"}, "robot source has no axis 'yaw'; it has x"),
        ({"x": "m", "heading": "rad"}, "robot source has no axis 'yaw'; it has x, heading"),
        ({"x": "m", "yaw": "m"}, "axis yaw of robot source is in m, that of the target target"),
    ],
)
def test_axes_that_only_some_robots_have_are_refused_by_name(
    source: dict[str, str], words: str
) -> None:
    fleet = {"target": several("target", x="m", yaw="rad"), "source": several("source", **source)}
    with pytest.raises(InvalidInputError, match=words):
        check_plan(replace(plan(), also=("yaw",)), fleet)


def test_all_axes_are_those_that_every_robot_has_in_the_same_unit_and_the_others_are_said() -> None:
    fleet = {
        "target": several("target", x="m", y="m", z="m", yaw="rad"),
        "near": several("near", x="m", y="m", yaw="rad"),
        "far": several("far", x="m", y="m", z="m", yaw="m"),
    }
    axes = chosen_axes(("all",), fleet["target"], fleet.values())
    assert axes == ("x", "y")
    study = replace(plan(), sources=("near", "far"), also=axes[1:])
    assert axes_left_out(study, fleet) == (
        "axis z is not compared: near has no such axis, but x, y, yaw",
        "axis yaw is not compared: far has it in m, and the target in rad",
    )
    apart = several("source", heading="rad")
    assert chosen_axes(("all",), fleet["target"], [apart]) == ("x",)


def test_one_amplitude_for_axes_in_several_units_is_refused() -> None:
    fleet = {name: several(name, x="m", yaw="rad") for name in ("target", "source")}
    with pytest.raises(InvalidInputError, match=r"several units \(x in m, yaw in rad\)"):
        check_plan(replace(plan(), also=("yaw",), amplitude=0.1), fleet)
