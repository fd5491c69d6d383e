"""The driver `mavlink`, as fleet files name it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from nufleet.robot_agent.drivers.mavlink.line import Line
from nufleet.robot_agent.drivers.mavlink.link import Link, LinkLine
from nufleet.robot_agent.drivers.mavlink.robot import MavlinkRobot
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings


class MavlinkDriver:
    """Builds robots that are reached over MAVLink."""

    settings: type[MavlinkSettings] = MavlinkSettings
    """Settings of one robot in a fleet file."""
    shares_process = False
    """Whether the robots of a fleet have to run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process of a robot needs."""

    def shares(self, settings: MavlinkSettings) -> str:
        """Return the port of a robot: robots on one port run in one process."""
        return settings.url

    def address(self, settings: MavlinkSettings) -> str:
        """Return the address at which only one robot of a fleet may be."""
        return f"system {settings.system_id} at {settings.url}"

    def build(
        self, settings: Mapping[str, MavlinkSettings], rng: np.random.Generator
    ) -> Mapping[str, MavlinkRobot]:
        """Build the robots, disconnected, by name."""
        del rng  # nothing is simulated
        links = {own.url: Link(own.url) for own in settings.values()}
        return {
            name: MavlinkRobot(name, own, _lines(links[own.url], own))
            for name, own in settings.items()
        }


def _lines(link: Link, own: MavlinkSettings) -> Callable[[], Line]:
    return partial(LinkLine, link, own.system_id, own.component_id, own.own_system_id)


DRIVER = MavlinkDriver()
