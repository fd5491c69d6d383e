"""Drivers of robots by name, found through the entry-point group `nufleet.robots`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.robots.fleet_file import FleetFile, validated_settings
from nufleet.shared.robots.installed import installed
from nufleet.shared.strict import Strict

ENTRY_POINT_GROUP = "nufleet.robots"


class RobotDriver(Protocol):
    """Builds robots of one kind (`nufleet.robot_agent.robot.Robot`) from their settings.

    Robots that share a simulator are built together: `build` receives all robots of its kind in one
    process, and `shares_process` requires that process to have all of the fleet's. A driver whose
    robots share something smaller, such as a radio, also has a method `shares(settings)` that
    returns its name for one robot, or None: robots of equal names run in one process. A driver of
    real robots has a method `address(settings)` that returns where one is reached: two robots of a
    fleet may not have equal addresses. A driver that needs packages of an extra has a method
    `require()`, which raises InvalidInputError without them; see `require_packages`.
    """

    @property
    def settings(self) -> type[Strict]:
        """Model that validates one robot's settings in a fleet file."""

    @property
    def shares_process(self) -> bool:
        """True if all robots of this kind in a fleet must run in one process."""

    @property
    def environment(self) -> Mapping[str, str]:
        """Environment variables that must be set before the process imports anything."""

    def build(self, settings: Mapping[str, Any], rng: np.random.Generator) -> Mapping[str, Any]:
        """Build robots, not yet connected.

        Args:
            settings: Validated settings of each robot, by its name.
            rng: Source of all simulated noise.

        Returns:
            The robots, by name.
        """


class SeparateRobots:
    """A driver of robots that share nothing, so that each can run in a process of its own.

    >>> from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings
    >>> driver = SeparateRobots(DoubleIntegratorSettings, DoubleIntegrator)
    >>> settings = DoubleIntegratorSettings(alpha=1.0, beta=0.003)
    >>> [*driver.build({"a": settings}, np.random.default_rng(0))]
    ['a']
    """

    shares_process = False
    """Whether the robots of a fleet have to run in one process."""

    def __init__(
        self,
        settings: type[Strict],
        robot: Callable[[Any, np.random.Generator], Any],
        environment: Mapping[str, str] | None = None,
    ) -> None:
        """Build robots of one class.

        Args:
            settings: Model of one robot's settings in a fleet file.
            robot: Class of the robots, or a function that builds one, from its settings and a
                source of noise of its own.
            environment: Variables that must be set before a robot's process imports anything.
        """
        self.settings = settings
        self.environment = environment or {}
        self._robot = robot

    def build(self, settings: Mapping[str, Any], rng: np.random.Generator) -> dict[str, Any]:
        """Build the robots, disconnected, by name."""
        streams = rng.spawn(len(settings))
        return {
            name: self._robot(own, stream)
            for (name, own), stream in zip(settings.items(), streams, strict=True)
        }


def shared_thing(driver: RobotDriver, settings: Callable[[], Any]) -> str | None:
    """Return the name of what a robot shares with others of its driver; None if it shares nothing.

    Args:
        driver: Driver of the robot.
        settings: Function that returns the validated settings of the robot, if they matter.
    """
    shares: Callable[[Any], str | None] | None = getattr(driver, "shares", None)
    if shares is not None:
        return shares(settings())
    return "simulator" if driver.shares_process else None


def load_driver(name: str) -> RobotDriver:
    """Return the driver of that name.

    Args:
        name: Name of the driver in the entry-point group.

    Raises:
        FleetFileError: no such driver is installed (the message lists those that are), or a package
            that it needs is not installed.
    """
    found = installed(ENTRY_POINT_GROUP)
    if name not in found:
        raise FleetFileError(
            f"unknown driver {name!r}; installed drivers: {', '.join(sorted(found)) or 'none'}"
        )
    try:
        driver: RobotDriver = found[name].load()
    except ImportError as error:
        raise FleetFileError(
            f"driver {name!r} cannot be loaded: {error}; `nufleet doctor` lists what drivers need"
        ) from error
    return driver


def require_packages(who: str, extra: str, *packages: str) -> None:
    """Check that the packages of an extra can be imported, without importing them.

    Args:
        who: The robots that need them, in the plural; the beginning of the message.
        extra: Name of the extra of nufleet that installs them.
        packages: Names under which they are imported.

    Raises:
        InvalidInputError: One of them is not installed; the message says how to install it.
    """
    missing = [package for package in packages if find_spec(package) is None]
    if missing:
        raise InvalidInputError(
            f"{who} need {' and '.join(missing)}: pip install 'nufleet[{extra}]'"
        )


def check_settings(fleet: FleetFile, path: Path) -> None:
    """Check the settings of every robot and the packages it needs, before any robot is started.

    Args:
        fleet: Contents of the fleet file.
        path: Path of the fleet file, for error messages.

    Raises:
        FleetFileError: settings are wrong, or a driver cannot be loaded.
        InvalidInputError: a package that a driver needs is not installed.
    """
    by_driver: dict[str, list[str]] = {}
    for name, entry in fleet.robots.items():
        by_driver.setdefault(entry.driver, []).append(name)
    for name, names in by_driver.items():
        driver = load_driver(name)
        settings_of(fleet, path, names, driver)
        require: Callable[[], None] = getattr(driver, "require", lambda: None)
        require()


def settings_of(
    fleet: FleetFile, path: Path, names: Iterable[str], driver: RobotDriver
) -> dict[str, Any]:
    """Return the validated settings of some robots of one driver, by name.

    Args:
        fleet: Contents of the fleet file.
        path: Path of the fleet file, for error messages.
        names: Names of the robots.
        driver: Driver of these robots.

    Raises:
        FleetFileError: Settings are wrong, or another robot of the file has the same address.
    """

    def validated(name: str) -> Any:
        return validated_settings(driver.settings, path, name, fleet.robots[name].settings)

    settings = {name: validated(name) for name in names}
    address: Callable[[Any], str] | None = getattr(driver, "address", None)
    if address is None or not settings:
        return settings
    at = {address(own): name for name, own in settings.items()}
    own_driver = fleet.robots[next(iter(settings))].driver
    for other, entry in fleet.robots.items():
        if entry.driver != own_driver:
            continue
        where = address(validated(other))
        if at.get(where, other) != other:
            raise FleetFileError(
                f"{path}: robots {other} and {at[where]} have the same address, {where}: one of "
                "them would move when the other is meant; give each its own"
            )
    return settings


def needed_environment(fleet: FleetFile, robots: Iterable[str]) -> dict[str, str]:
    """Return the environment variables that the drivers of these robots need.

    Args:
        fleet: Contents of the fleet file.
        robots: Names of robots in it.

    Raises:
        FleetFileError: a driver cannot be loaded.
    """
    drivers = {fleet.robots[robot].driver for robot in robots}
    return {k: v for name in sorted(drivers) for k, v in load_driver(name).environment.items()}
