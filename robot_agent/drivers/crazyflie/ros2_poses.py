"""Tells where motion capture sees bodies, from topics of ROS 2 instead of `motioncapture`."""

from __future__ import annotations

import time
from collections.abc import Callable
from contextlib import ExitStack
from functools import partial
from importlib import import_module
from types import SimpleNamespace
from typing import Any

from nufleet.shared.errors import RobotError

POSE = "geometry_msgs/msg/PoseStamped"
LOOK_S = 0.5
"""Interval at which new topics are looked for."""
WAIT_S = 0.1
"""Longest wait for a pose."""


class Ros2Poses:
    """Reads the topics `NAMESPACE/BODY/pose`, as `vrpn_mocap` and other packages publish them."""

    def __init__(self, namespace: str) -> None:
        """Begin to listen.

        Args:
            namespace: Namespace of all bodies, such as `/vrpn_mocap`; `/` if they have none.

        Raises:
            RobotError: ROS 2 cannot be imported.
        """
        try:
            import rclpy
            from rclpy.context import Context
            from rclpy.executors import SingleThreadedExecutor
            from rclpy.node import Node
            from rclpy.signals import SignalHandlerOptions

            self._type = import_module("geometry_msgs.msg").PoseStamped
        except ImportError as error:
            raise RobotError(
                f"motion capture over ROS 2 needs rclpy and geometry_msgs ({error}): run `source "
                "/opt/ros/DISTRO/setup.bash` in the shell that starts the agent"
            ) from error
        self._before = f"{namespace.rstrip('/')}/"
        self.rigidBodies: dict[str, Any] = {}
        """Position and rotation of each body that the last frame told of."""
        self._coming: dict[str, Any] = {}
        self._stamps: dict[str, tuple[int, int]] = {}
        self._looked_s = 0.0
        with ExitStack() as opened:
            context = Context()
            rclpy.init(args=[], context=context, signal_handler_options=SignalHandlerOptions.NO)
            opened.callback(context.try_shutdown)
            self._node = Node("nufleet_motion_capture", context=context, enable_rosout=False)
            opened.callback(self._node.destroy_node)
            self._executor = SingleThreadedExecutor(context=context)
            self._executor.add_node(self._node)
            opened.callback(self._executor.shutdown)
            self._opened = opened.pop_all()

    def waitForNextFrame(self) -> None:  # noqa: N802 - as the package names it
        """Wait for poses, a little while at most; `rigidBodies` then has those that came."""
        now_s = time.monotonic()
        if now_s - self._looked_s > LOOK_S:
            self._looked_s = now_s
            self._look()
        self._coming = {}
        self._executor.spin_once(timeout_sec=WAIT_S)
        for _ in self._stamps:  # what came for the other bodies meanwhile
            self._executor.spin_once(timeout_sec=0.0)
        self.rigidBodies = self._coming

    def close(self) -> None:
        """Leave ROS 2."""
        self._opened.close()

    def _look(self) -> None:
        """Listen to bodies whose topics are new."""
        for topic, kinds in self._node.get_topic_names_and_types():
            body = topic.removeprefix(self._before).removesuffix("/pose")
            if POSE not in kinds or topic != f"{self._before}{body}/pose" or body in self._stamps:
                continue
            self._stamps[body] = (0, 0)
            self._listen(topic, partial(self._take, body))

    def _listen(self, topic: str, take: Callable[[Any], None]) -> None:
        from rclpy.qos import qos_profile_sensor_data

        self._node.create_subscription(self._type, topic, take, qos_profile_sensor_data)

    def _take(self, body: str, message: Any) -> None:
        """Take a pose; one that only repeats the last one, of a body that is lost, is dropped."""
        stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
        if stamp == self._stamps[body] != (0, 0):
            return
        self._stamps[body] = stamp
        place = message.pose.position
        self._coming[body] = SimpleNamespace(
            position=[place.x, place.y, place.z], rotation=message.pose.orientation
        )
