"""The driver `mavlink`, as fleet files name it."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial

import numpy as np

from nufleet.robot_agent.drivers.mavlink.line import Line
from nufleet.robot_agent.drivers.mavlink.link import Link, LinkLine
from nufleet.robot_agent.drivers.mavlink.robot import MavlinkRobot
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.shared.errors import FleetFileError


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

    def build(
        self, settings: Mapping[str, MavlinkSettings], rng: np.random.Generator
    ) -> Mapping[str, MavlinkRobot]:
        """Build the robots, disconnected, by name.

        Raises:
            FleetFileError: Two of them are one vehicle.
        """
        del rng  # nothing is simulated
        owners: dict[tuple[str, int], str] = {}
        for name, own in settings.items():
            other = owners.setdefault((own.url, own.system_id), name)
            if other != name:
                raise FleetFileError(
                    f"{other} and {name} both are system {own.system_id} at {own.url}: give each "
                    "vehicle its own id (PX4 MAV_SYS_ID, ArduPilot SYSID_THISMAV), and its "
                    "system_id in the fleet file"
                )
        links = {own.url: Link(own.url) for own in settings.values()}
        return {
            name: MavlinkRobot(name, own, _lines(links[own.url], own))
            for name, own in settings.items()
        }


def _lines(link: Link, own: MavlinkSettings) -> Callable[[], Line]:
    return partial(LinkLine, link, own.system_id, own.component_id, own.own_system_id)


DRIVER = MavlinkDriver()
