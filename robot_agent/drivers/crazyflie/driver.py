"""The driver `crazyflie`: drones of Bitcraze, several of them on one radio."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from nufleet.robot_agent.drivers.crazyflie.address import dongle_of, identity_of
from nufleet.robot_agent.drivers.crazyflie.motion_capture import MotionCapture, Sighting
from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.shared.robots.drivers import require_packages


class CrazyflieDriver:
    """Builds Crazyflies; those that share a radio share a process."""

    settings: type[CrazyflieSettings] = CrazyflieSettings
    """Settings of one robot in a fleet file."""
    shares_process = False
    """Whether the robots of a fleet have to run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process of a robot needs."""

    def shares(self, settings: CrazyflieSettings) -> str | None:
        """Return the radio through which a drone is reached; None if through none."""
        return dongle_of(settings.uri)

    def address(self, settings: CrazyflieSettings) -> str:
        """Return the address at which only one robot of a fleet may be."""
        return identity_of(settings.uri)

    def require(self) -> None:
        """Check that cflib is installed."""
        require_packages("Crazyflies", "crazyflie", "cflib")

    def build(
        self, settings: Mapping[str, CrazyflieSettings], rng: np.random.Generator
    ) -> dict[str, Crazyflie]:
        """Build the robots, disconnected, by name.

        Raises:
            InvalidInputError: cflib is not installed.
        """
        del rng  # a real drone has noise of its own
        self.require()
        systems: dict[tuple[str, str], MotionCapture] = {}
        built: dict[str, Crazyflie] = {}
        for name, own in settings.items():
            seen_by, sighting = own.motion_capture, None
            if seen_by is not None:
                where = (seen_by.system, seen_by.hostname)
                sighting = Sighting(seen_by, systems.setdefault(where, MotionCapture(*where)))
            built[name] = Crazyflie(name, own, sighting)
        return built


DRIVER = CrazyflieDriver()
