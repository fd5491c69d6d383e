"""Messages become measured components, and set-points become messages, field by field."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest
from ros2_lab import ARM, CART, DRONE, Message, settings

from nufleet.robot_agent.drivers.ros2.messages import Battery, SetPoint, measured, message_of
from nufleet.robot_agent.drivers.ros2.settings import CommandTopic, MeasurementTopic
from nufleet.shared.errors import RobotError

HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=12, nanosec=500_000_000), frame_id="map")
ORIGIN = SimpleNamespace(x=1.0, y=2.0, z=3.0)
A_THIRD = SimpleNamespace(x=0.0, y=0.0, z=math.sin(math.pi / 6), w=math.cos(math.pi / 6))
POSE = SimpleNamespace(position=ORIGIN, orientation=A_THIRD)
PLACE = {"x": 1.0, "y": 2.0, "z": 3.0, "yaw": pytest.approx(math.pi / 3)}


def topic(kind: str, **more: Any) -> MeasurementTopic:
    return MeasurementTopic.model_validate({"topic": "m", "type": kind, **more})


def transform(parent: str, child: str) -> SimpleNamespace:
    header = SimpleNamespace(stamp=HEADER.stamp, frame_id=parent)
    moved = SimpleNamespace(translation=ORIGIN, rotation=A_THIRD)
    return SimpleNamespace(header=header, child_frame_id=child, transform=moved)


@pytest.mark.parametrize(
    ("kind", "message"),
    [
        ("geometry_msgs/msg/PoseStamped", SimpleNamespace(header=HEADER, pose=POSE)),
        (
            "nav_msgs/msg/Odometry",
            SimpleNamespace(header=HEADER, pose=SimpleNamespace(pose=POSE, covariance=[0.0])),
        ),
        (
            "geometry_msgs/msg/PoseWithCovarianceStamped",
            SimpleNamespace(header=HEADER, pose=SimpleNamespace(pose=POSE, covariance=[0.0])),
        ),
    ],
)
def test_a_stamped_pose_is_a_place_and_a_time(kind: str, message: Any) -> None:
    said = measured(message, topic(kind))
    assert said is not None
    assert (said.stamp_s, dict(said.values)) == (12.5, PLACE)


def test_of_all_transforms_the_one_between_the_robots_frames_is_its_pose() -> None:
    frames = {"parent": "map", "child": "base_link"}
    message = SimpleNamespace(
        transforms=[transform("odom", "base_link"), transform("/map", "base_link")]
    )
    said = measured(message, topic("tf2_msgs/msg/TFMessage", **frames))
    assert said is not None
    assert dict(said.values) == PLACE
    message.transforms.pop()
    assert measured(message, topic("tf2_msgs/msg/TFMessage", **frames)) is None


def test_joints_are_found_by_name() -> None:
    message = SimpleNamespace(header=HEADER, name=["b", "a"], position=[0.1, 0.2])
    said = measured(message, topic("sensor_msgs/msg/JointState"))
    assert said is not None
    assert (said.stamp_s, dict(said.values)) == (12.5, {"a": 0.2, "b": 0.1})


def test_messages_without_a_stamp_have_none() -> None:
    unstamped = SimpleNamespace(stamp=SimpleNamespace(sec=0, nanosec=0), frame_id="")
    blank = measured(
        SimpleNamespace(header=unstamped, pose=POSE), topic("geometry_msgs/msg/PoseStamped")
    )
    bare = measured(POSE, topic("geometry_msgs/msg/Pose", stamps="arrival"))
    assert blank is not None
    assert bare is not None
    assert (blank.stamp_s, bare.stamp_s, dict(bare.values)) == (None, None, PLACE)


def test_an_orientation_that_is_none_gives_no_yaw() -> None:
    empty = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=0.0)
    message = SimpleNamespace(
        header=HEADER, pose=SimpleNamespace(position=ORIGIN, orientation=empty)
    )
    said = measured(message, topic("geometry_msgs/msg/PoseStamped"))
    assert said is not None
    assert math.isnan(said.values["yaw"])


def test_a_charge_is_a_share() -> None:
    battery = Battery("/cf1/battery", 0.0)
    assert battery.charge(9.0) is None
    battery.take(SimpleNamespace(percentage=0.4), 9.0)
    assert battery.charge(18.0) == 0.4
    battery.take(SimpleNamespace(percentage=87.0), 18.0)
    with pytest.raises(RobotError, match=r"reports a charge of 87; .* from 0 to 1"):
        battery.charge(18.0)


@pytest.mark.parametrize("said", [[], [math.nan] * 12])
def test_a_battery_that_says_nothing_more_or_does_not_know_its_charge_is_unknown(
    said: list[float],
) -> None:
    battery = Battery("/cf1/battery", 0.0)
    battery.take(SimpleNamespace(percentage=0.4), 0.5)
    for k, share in enumerate(said):
        battery.take(SimpleNamespace(percentage=share), float(k))
    with pytest.raises(RobotError, match=r"no charge came on /cf1/battery for 10\.5 s"):
        battery.charge(11.0)


def sent(kind: str, point: SetPoint, **more: Any) -> Any:
    command = CommandTopic.model_validate({"topic": "c", "type": kind, **more})
    made = {"geometry_msgs/msg/Twist": lambda: SimpleNamespace(linear=Message(), angular=Message())}

    def make(name: str) -> Any:
        return made.get(name, Message)()

    return message_of(point, command, 3_250_000_000, 0.02, make)


POINT = SetPoint(
    {"x": 1.0, "y": 2.0, "z": 3.0, "yaw": math.pi / 3}, {"x": 0.1, "y": 0.2, "z": 0.3, "yaw": 0.4}
)


def test_a_pose_has_its_frame_its_time_and_a_level_orientation() -> None:
    message = sent("geometry_msgs/msg/PoseStamped", POINT, frame_id="world")
    assert (message.header.frame_id, message.header.stamp.sec) == ("world", 3)
    assert message.header.stamp.nanosec == 250_000_000
    place, turn = message.pose.position, message.pose.orientation
    assert (place.x, place.y, place.z) == (1.0, 2.0, 3.0)
    assert (turn.x, turn.y, turn.z, turn.w) == (0.0, 0.0, A_THIRD.z, A_THIRD.w)


@pytest.mark.parametrize("velocity", [True, False])
def test_a_trajectory_has_one_point_due_one_sample_later(velocity: bool) -> None:
    kind = "trajectory_msgs/msg/MultiDOFJointTrajectory"
    (step,) = sent(kind, POINT, velocity=velocity).points
    assert (step.time_from_start.sec, step.time_from_start.nanosec) == (0, 20_000_000)
    (place,) = step.transforms
    assert (place.translation.y, place.rotation.z) == (2.0, A_THIRD.z)
    if velocity:
        (twist,) = step.velocities
        assert (twist.linear.z, twist.angular.z) == (0.3, 0.4)


def test_joints_are_commanded_by_name() -> None:
    point = SetPoint({"a": 0.1, "b": 0.2}, {"a": 1.0, "b": 2.0})
    message = sent("trajectory_msgs/msg/JointTrajectory", point, velocity=True)
    (step,) = message.points
    assert message.joint_names == ["a", "b"]
    assert (step.positions, step.velocities) == ([0.1, 0.2], [1.0, 2.0])
    # A controller rejects a trajectory that came after its time; one without a stamp begins now.
    assert (message.header.stamp.sec, message.header.stamp.nanosec) == (0, 0)


@pytest.mark.parametrize("stamped", [True, False])
def test_a_twist_is_in_the_frame_of_the_body_or_of_the_world(stamped: bool) -> None:
    kind = "geometry_msgs/msg/TwistStamped" if stamped else "geometry_msgs/msg/Twist"
    point = SetPoint({"yaw": math.pi / 2}, {"x": 0.0, "y": 0.5, "yaw": 0.1})
    body = sent(kind, point, gain_1_s=1.0)
    world = sent(kind, point, gain_1_s=1.0, twist_frame="world")
    if stamped:
        assert body.header.stamp.sec == 3
        assert (body.header.frame_id, world.header.frame_id) == ("base_link", "map")
        body, world = body.twist, world.twist
    assert (body.linear.x, body.linear.y) == (pytest.approx(0.5), pytest.approx(0.0))
    assert (world.linear.x, world.linear.y, world.angular.z) == (0.0, 0.5, 0.1)


def test_every_type_of_a_fleet_file_is_understood() -> None:
    for document in (DRONE, ARM, CART):
        own = settings(document)
        place = dict.fromkeys((*own.commanded, "yaw"), 0.0)
        assert sent(own.command.type, SetPoint(place, place), gain_1_s=own.command.gain_1_s)
