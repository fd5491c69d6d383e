"""The driver `ros2`: one robot per entry, each in a process of its own if need be."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nufleet.robot_agent.drivers.ros2.node import RosNode
from nufleet.robot_agent.drivers.ros2.robot import Ros2Robot
from nufleet.robot_agent.drivers.ros2.settings import Ros2Settings
from nufleet.robot_agent.robot import Robot
from nufleet.shared.strict import Strict


class Ros2Driver:
    """Builds robots on ROS 2; rclpy is imported when they are connected."""

    settings: type[Strict] = Ros2Settings
    """Settings of one robot in a fleet file."""
    shares_process = False
    """Whether the robots of a fleet have to run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process of a robot needs."""

    def address(self, settings: Ros2Settings) -> str:
        """Return where one robot takes its set-points; another one may not take the same."""
        domain = settings.domain_id
        known = "ROS_DOMAIN_ID" if domain is None else domain
        return f"{settings.full(settings.command.topic)} in the ROS domain {known}"

    def build(
        self, settings: Mapping[str, Ros2Settings], rng: np.random.Generator
    ) -> Mapping[str, Robot]:
        """Build the robots, disconnected, by name; real robots need no generator."""
        return {name: Ros2Robot(name, own, RosNode) for name, own in settings.items()}


DRIVER = Ros2Driver()
