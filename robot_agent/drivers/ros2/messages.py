"""Converts messages of ROS 2 to measured components, and set-points to messages.

Messages are taken and filled by the names of their fields, so that nothing of ROS is imported here.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from nufleet.robot_agent.drivers.ros2.settings import (
    JOINT_COMMAND,
    JOINT_MEASUREMENT,
    TF,
    TWISTS,
    UNSTAMPED,
    CommandTopic,
    MeasurementTopic,
)
from nufleet.shared.errors import RobotError

NS_PER_S = 1_000_000_000
UNIT_ERROR_MAX = 0.1
"""Largest deviation of an orientation's norm from 1."""
CHARGE_MAX_S = 10.0
"""Longest time for which the charge of a battery may be unknown."""


@dataclass(frozen=True)
class Measured:
    """What one message says of the robot."""

    stamp_s: float | None
    """Its time stamp, on the publisher's clock; None if it has none."""

    values: Mapping[str, float]
    """Value of each component or joint in it, in m and rad."""


@dataclass(frozen=True)
class SetPoint:
    """Where the robot shall be."""

    positions: Mapping[str, float]
    """Position of each component or joint, in the frame of the topics."""

    velocities: Mapping[str, float]
    """Velocity of each component: the reference's, or the command of a Twist in the world frame."""


def measured(message: Any, topic: MeasurementTopic) -> Measured | None:
    """Return what a message says; None if it is of another frame or of other joints.

    Args:
        message: Message of the topic's type.
        topic: Topic that it came from.
    """
    if topic.type == UNSTAMPED:
        return Measured(None, _pose(message.position, message.orientation))
    if topic.type == TF:
        for transform in message.transforms:
            frames = (transform.header.frame_id, transform.child_frame_id)
            if tuple(map(_bare, frames)) == (_bare(topic.parent), _bare(topic.child)):
                moved = transform.transform
                values = _pose(moved.translation, moved.rotation)
                return Measured(_stamp_s(transform.header), values)
        return None
    if topic.type == JOINT_MEASUREMENT:
        joints = dict(zip(message.name, map(float, message.position), strict=False))
        return Measured(_stamp_s(message.header), joints) if joints else None
    # An Odometry and a PoseWithCovarianceStamped hold their pose beside its covariance.
    pose = getattr(message.pose, "pose", message.pose)
    return Measured(_stamp_s(message.header), _pose(pose.position, pose.orientation))


class Battery:
    """The charge that BatteryStates report; any thread may ask for it."""

    def __init__(self, topic: str, now_s: float) -> None:
        """Begin without a message.

        Args:
            topic: Full name of the topic, for errors.
            now_s: The time, as for `take` and `charge`.
        """
        self._topic = topic
        self._newest: tuple[float | None, float] = (None, now_s)

    def take(self, message: Any, now_s: float) -> None:
        """Take a BatteryState; one that does not know the charge is passed over."""
        share = float(message.percentage)
        if not math.isnan(share):
            self._newest = (share, now_s)

    def charge(self, now_s: float) -> float | None:
        """Return the newest charge, 0 to 1; None before the first.

        Raises:
            RobotError: The charge is not a share, or has been unknown for `CHARGE_MAX_S`.
        """
        share, at_s = self._newest
        if now_s - at_s > CHARGE_MAX_S:
            raise RobotError(
                f"no charge came on {self._topic} for {now_s - at_s:.3g} s: check its publisher, "
                "or leave the battery out of the fleet file if it does not know its charge"
            )
        if share is not None and not 0 <= share <= 1:
            raise RobotError(
                f"its battery reports a charge of {share:g}; BatteryState.percentage is from 0 to 1"
            )
        return share


def message_of(
    point: SetPoint,
    topic: CommandTopic,
    now_ns: int,
    sample_time_s: float,
    make: Callable[[str], Any],
) -> Any:
    """Return the message of a set-point.

    Args:
        point: The set-point; for a Twist, with the yaw that was measured.
        topic: Topic to send it on.
        now_ns: Time for its header, on the node's clock.
        sample_time_s: Time until a trajectory's point is due.
        make: Function that returns a new message of a type.
    """
    message = make(topic.type)
    if hasattr(message, "header"):
        message.header.frame_id = topic.frame
        # A joint trajectory controller rejects a point that came after its time, which the stamp 0
        # prevents: the trajectory begins when it comes.
        stamp_ns = 0 if topic.type == JOINT_COMMAND else now_ns
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, NS_PER_S)
    if topic.type in TWISTS:
        _fill_twist(getattr(message, "twist", message), point, topic)
    elif topic.type == JOINT_COMMAND:
        names = list(point.positions)
        step = make("trajectory_msgs/msg/JointTrajectoryPoint")
        step.positions = [point.positions[name] for name in names]
        if topic.velocity:
            step.velocities = [point.velocities[name] for name in names]
        message.joint_names = names
        _fill_due(step, sample_time_s)
        message.points = [step]
    elif topic.type == "geometry_msgs/msg/PoseStamped":
        _fill_xyz(message.pose.position, point.positions)
        _fill_yaw(message.pose.orientation, point.positions["yaw"])
    else:
        step = make("trajectory_msgs/msg/MultiDOFJointTrajectoryPoint")
        place = make("geometry_msgs/msg/Transform")
        _fill_xyz(place.translation, point.positions)
        _fill_yaw(place.rotation, point.positions["yaw"])
        step.transforms = [place]
        if topic.velocity:
            twist = make("geometry_msgs/msg/Twist")
            _fill_xyz(twist.linear, point.velocities)
            twist.angular.z = point.velocities["yaw"]
            step.velocities = [twist]
        _fill_due(step, sample_time_s)
        message.points = [step]
    return message


def _pose(position: Any, orientation: Any) -> dict[str, float]:
    x, y, z, w = (float(getattr(orientation, name)) for name in "xyzw")
    yaw = math.atan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))
    if abs(math.sqrt(x * x + y * y + z * z + w * w) - 1) > UNIT_ERROR_MAX:
        yaw = math.nan
    return {**{name: float(getattr(position, name)) for name in "xyz"}, "yaw": yaw}


def _stamp_s(header: Any) -> float | None:
    stamp_s = header.stamp.sec + header.stamp.nanosec / NS_PER_S
    return stamp_s if stamp_s > 0 else None


def _bare(frame: str | None) -> str | None:
    return None if frame is None else frame.removeprefix("/")


def _fill_xyz(vector: Any, values: Mapping[str, float]) -> None:
    vector.x, vector.y, vector.z = values["x"], values["y"], values["z"]


def _fill_yaw(quaternion: Any, yaw: float) -> None:
    quaternion.x = quaternion.y = 0.0
    quaternion.z, quaternion.w = math.sin(yaw / 2), math.cos(yaw / 2)


def _fill_due(point: Any, sample_time_s: float) -> None:
    due_ns = round(sample_time_s * NS_PER_S)
    point.time_from_start.sec, point.time_from_start.nanosec = divmod(due_ns, NS_PER_S)


def _fill_twist(twist: Any, point: SetPoint, topic: CommandTopic) -> None:
    velocity = {name: point.velocities.get(name, 0.0) for name in ("x", "y", "z", "yaw")}
    yaw = point.positions["yaw"] if topic.twist_frame == "body" else 0.0
    twist.linear.x = math.cos(yaw) * velocity["x"] + math.sin(yaw) * velocity["y"]
    twist.linear.y = -math.sin(yaw) * velocity["x"] + math.cos(yaw) * velocity["y"]
    twist.linear.z, twist.angular.z = velocity["z"], velocity["yaw"]
