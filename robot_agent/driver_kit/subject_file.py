"""Finds the robot to check, from the name of a driver or from a fleet file."""

from __future__ import annotations

import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from nufleet.robot_agent.robot import Robot
from nufleet.robot_agent.serve import build_robots
from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.robots.drivers import ENTRY_POINT_GROUP, load_driver, needed_environment
from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file, validated_settings
from nufleet.shared.robots.installed import installed


def robot_to_check(
    target: str, robot: str | None, settings_toml: str
) -> tuple[str, Mapping[str, str], Callable[[], Robot]]:
    """Return a robot's name, the environment that its driver needs, and how to build it.

    Args:
        target: Name of a driver, path of a fleet file, or name of an installed one.
        robot: Name of the robot in the fleet file; None for its first one.
        settings_toml: Settings of the driver, as TOML whose lines may be separated by `;`.

    Raises:
        InvalidInputError: There is no such driver or fleet file, or a setting is wrong.
    """
    if target in installed(ENTRY_POINT_GROUP):
        driver = load_driver(target)
        try:
            table = tomllib.loads(settings_toml.replace(";", "\n"))
        except tomllib.TOMLDecodeError as error:
            raise InvalidInputError(f"--settings is not TOML: {error}") from error
        settings = validated_settings(driver.settings, Path("--settings"), target, table)
        return (
            target,
            driver.environment,
            lambda: driver.build({target: settings}, np.random.default_rng(0))[target],
        )
    try:
        path = find_fleet_file(target)
    except FleetFileError as error:
        drivers = ", ".join(sorted(installed(ENTRY_POINT_GROUP)))
        raise FleetFileError(f"{error}; installed drivers: {drivers}") from error
    if settings_toml:
        raise InvalidInputError("--settings is for a driver; a fleet file has its own settings")
    fleet = read_fleet_file(path)
    name = robot or next(iter(fleet.robots))
    if name not in fleet.robots:
        raise FleetFileError(f"{path}: no robot {name!r}; there are {', '.join(fleet.robots)}")
    needed = needed_environment(fleet, (name,))
    return name, needed, lambda: build_robots(fleet, path, (name,))[name]
