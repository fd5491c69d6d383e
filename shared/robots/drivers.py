"""Robots by name: drivers are found through the entry-point group `nufleet.robots`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nufleet.shared.errors import FleetFileError
from nufleet.shared.robots.fleet_file import FleetFile, validated_settings
from nufleet.shared.strict import Strict

ENTRY_POINT_GROUP = "nufleet.robots"


class RobotDriver(Protocol):
    """Builds robots of one kind (`nufleet.robot_agent.robot.Robot`) from their settings.

    Robots that share one simulator are built together: `build` takes all robots of its kind that
    live in one process, and `shares_process` says that all of a fleet must.
    """

    @property
    def settings(self) -> type[Strict]:
        """The model of one robot's settings in a fleet file."""

    @property
    def shares_process(self) -> bool:
        """Whether all robots of this kind in a fleet have to live in one process."""

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables that have to be set before the process imports anything."""

    def build(self, settings: Mapping[str, Any], rng: np.random.Generator) -> Mapping[str, Any]:
        """Build the robots, disconnected, by name."""


def load_driver(name: str) -> RobotDriver:
    """Return the driver of that name.

    Raises:
        FleetFileError: there is none, with the names there are; or what it needs is not installed.
    """
    found = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if name not in found:
        raise FleetFileError(
            f"unknown driver {name!r}; installed drivers: {', '.join(sorted(found)) or 'none'}"
        )
    try:
        driver: RobotDriver = found[name].load()
    except ImportError as error:
        raise FleetFileError(f"driver {name!r} cannot be loaded: {error}") from error
    return driver


def check_settings(fleet: FleetFile, path: Path) -> None:
    """Check every robot's settings before anything is started; raises FleetFileError."""
    models = {
        driver: load_driver(driver).settings
        for driver in {entry.driver for entry in fleet.robots.values()}
    }
    for name, entry in fleet.robots.items():
        validated_settings(models[entry.driver], path, name, entry.settings)


def needed_environment(fleet: FleetFile, robots: Iterable[str]) -> dict[str, str]:
    """Return the environment variables that these robots' drivers need to find set."""
    drivers = {fleet.robots[robot].driver for robot in robots}
    return {k: v for name in sorted(drivers) for k, v in load_driver(name).environment.items()}
