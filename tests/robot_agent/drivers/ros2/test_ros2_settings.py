"""A fleet file describes a robot on ROS 2 wholly, and what cannot be is refused before it moves."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError
from ros2_lab import ARM, CART, DRONE, FLYING, settings

from nufleet.shared.strict import describe_validation


def test_the_description_holds_the_axes_the_limits_and_the_chain_of_measurement() -> None:
    spec = settings(measurement={**DRONE["measurement"], "source": "motion-capture"}).spec()
    assert [axis.name for axis in spec.axes] == ["x", "y"]
    assert (spec.kind, spec.sample_time_s, spec.simulated) == ("lab-drone", 0.02, False)
    assert (spec.measurement, spec.delay_uncertainty_s) == ("motion-capture", 0.002)


def test_outputs_that_are_timed_by_their_arrival_say_so_and_are_less_certain() -> None:
    by_arrival = {**DRONE["measurement"], "stamps": "arrival"}
    spec = settings(measurement=by_arrival).spec()
    assert (spec.measurement, spec.delay_uncertainty_s) == ("onboard-by-arrival", 0.01)
    known = settings(measurement={**by_arrival, "delay_uncertainty_s": 0.004}).spec()
    assert known.delay_uncertainty_s == 0.004


def test_stamps_in_simulated_time_are_of_the_clock_that_paces_the_samples() -> None:
    spec = settings(use_sim_time=True).spec()
    assert (spec.simulated, spec.delay_uncertainty_s) == (True, 0.001)


def test_names_are_in_the_namespace_unless_they_are_absolute() -> None:
    own = settings()
    assert (own.full("odom"), own.full("/tf")) == ("/cf1/odom", "/tf")
    assert settings(namespace="").full("odom") == "/odom"


def test_a_pose_is_commanded_as_a_whole_joints_as_listed_and_a_twist_as_needed() -> None:
    assert settings().commanded == ("x", "y", "z", "yaw")
    assert settings(ARM).commanded == ("Elbow_1", "Wrist_1")
    assert settings(CART).commanded == ("x", "y")
    assert settings(CART).measured == ("x", "y", "yaw")


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"namespace": "cf1"}, "namespace"),
        ({"command": {**DRONE["command"], "type": "std_msgs/msg/String"}}, "command.type"),
        ({"command": {**CART["command"], "gain_1_s": None}}, "gain_1_s belongs to a Twist"),
        ({"command": ARM["command"]}, "joints are commanded and measured, or a pose"),
        ({"axes": [{**DRONE["axes"][0], "name": "elbow"}]}, "a pose has the components x, y, z"),
        ({"axes": [{**DRONE["axes"][0], "unit": "rad"}]}, "the unit of x is m"),
        ({"hold": {"x": 0.0}}, "x: moved by two axes, or moved and held"),
        ({"measurement": {"topic": "/tf", "type": "tf2_msgs/msg/TFMessage"}}, "parent and child"),
        ({"measurement": {"topic": "p", "type": "geometry_msgs/msg/Pose"}}, 'stamps = "arrival"'),
        ({"services": {"take_off": "up"}}, "a robot has both or neither"),
        ({"services": FLYING}, "idle_s: a robot that takes off needs it"),
        ({**ARM, "services": FLYING, "idle_s": 9.0}, "reports no height to land by"),
        ({"omega_max_rad_s": 200.0}, "Nyquist"),
        ({"battery": {"topic": "b", "reserve": 1.5}}, "battery.reserve"),
        ({"services": {"arm": "arm it"}}, "services.arm"),
        # Landing and disarming have to end before the agent takes the driver for one that hangs.
        ({"services": {"arm": "arm", "timeout_s": 20.0}}, "services.timeout_s"),
        ({"services": {"arm": "arm", "land_s": 30.0}}, "services.land_s"),
        ({"topic": "odom"}, "topic: unknown"),
    ],
)
def test_what_cannot_be_is_refused_in_words(changes: dict[str, Any], said: str) -> None:
    with pytest.raises(ValidationError) as caught:
        settings(**changes)
    assert said in describe_validation(caught.value)
