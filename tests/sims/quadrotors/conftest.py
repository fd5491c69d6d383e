"""The paper's fleet, built once: three programs are compiled, for all tests."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pytest

from nufleet.robot_agent.robot import Robot
from nufleet.shared.robots.drivers import RobotDriver
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.sims.quadrotors.driver import DRIVER
from nufleet.sims.quadrotors.settings import QuadrotorSettings, SensorNoise


@pytest.fixture(scope="session")
def paper_settings(
    fleet_file: Callable[[str], FleetFile],
    settings_of: Callable[[FleetFile, RobotDriver], dict[str, Any]],
) -> dict[str, QuadrotorSettings]:
    return settings_of(fleet_file("paper_quadrotors"), DRIVER)


@pytest.fixture(scope="session")
def built(paper_settings: dict[str, QuadrotorSettings]) -> Mapping[str, Robot]:
    """The paper's fleet, and more of the same.

    `quiet-…` are without measurement noise, `position-…` also without velocity reference.
    """
    silence = SensorNoise(position_m=0.0, velocity_m_s=0.0, tilt_rad=0.0)
    robots = dict(paper_settings)
    for name, settings in paper_settings.items():
        quiet = settings.model_copy(update={"noise": silence})
        robots[f"quiet-{name}"] = quiet
        robots[f"position-{name}"] = quiet.model_copy(update={"velocity_reference": False})
    return DRIVER.build(robots, np.random.default_rng(0))


@pytest.fixture(scope="session")
def fresh(built: Mapping[str, Robot]) -> Callable[[str], Robot]:
    """Put one of the robots at rest at the origin and return it."""

    def connect_anew(name: str) -> Robot:
        built[name].disconnect()
        built[name].connect()
        return built[name]

    return connect_anew
