"""Builds the robots of a fleet file that one agent process serves."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from robot_agent.robot import Robot
from shared.drivers import load_driver
from shared.errors import FleetFileError
from shared.fleet_file import FleetFile, validated_settings


def build_robots(fleet: FleetFile, path: Path, names: tuple[str, ...]) -> dict[str, Robot]:
    """Build some robots of a fleet file, in the order of the names given.

    A robot's noise depends on the fleet's seed and the robot's place in the file, not on which
    other robots its process serves; but robots that share one simulator share its noise too.

    Raises:
        FleetFileError: for a name, driver or setting that is not right.
    """
    unknown = [name for name in names if name not in fleet.robots]
    if unknown:
        raise FleetFileError(
            f"{path}: no robot {unknown[0]!r}; there are {', '.join(fleet.robots)}"
        )
    by_driver: dict[str, list[str]] = {}
    for name in (name for name in fleet.robots if name in names):
        by_driver.setdefault(fleet.robots[name].driver, []).append(name)
    places = {name: place for place, name in enumerate(fleet.robots)}
    built: dict[str, Robot] = {}
    for driver_name, members in by_driver.items():
        driver = load_driver(driver_name)
        settings = {
            name: validated_settings(driver.settings, path, name, fleet.robots[name].settings)
            for name in members
        }
        groups = [members] if driver.shares_process else [[name] for name in members]
        for group in groups:
            rng = np.random.default_rng([fleet.seed, places[group[0]]])
            built.update(driver.build({name: settings[name] for name in group}, rng))
    return {name: built[name] for name in names}
