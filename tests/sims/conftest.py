"""What tests of simulated robots share: reading the fleet files, and an independent estimator."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from nufleet import sims
from nufleet.robot_agent.robot import Robot
from nufleet.shared.robots.drivers import RobotDriver
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file, validated_settings

Respond = Callable[[Robot, float, int], complex]


@pytest.fixture(scope="session")
def fleet_file() -> Callable[[str], FleetFile]:
    """Read a fleet file that comes with the package."""
    return lambda name: read_fleet_file(Path(sims.__file__).parent / "fleets" / f"{name}.toml")


@pytest.fixture(scope="session")
def settings_of() -> Callable[[FleetFile, RobotDriver], dict[str, Any]]:
    """Validate the settings of every robot of a fleet file."""
    return lambda fleet, driver: {
        name: validated_settings(driver.settings, Path(fleet.name), name, entry.settings)
        for name, entry in fleet.robots.items()
    }


@pytest.fixture(scope="session")
def respond() -> Respond:
    """Measure z(ω) = Y/U on one axis with a sinusoid at 80 % of the axis's limits."""

    def measure(robot: Robot, omega_rad_s: float, axis: int = 0) -> complex:
        spec, limits = robot.spec, robot.spec.axes[axis]
        amplitude = 0.8 * min(
            limits.amplitude_max,
            limits.velocity_max / omega_rad_s,
            limits.acceleration_max / omega_rad_s**2,
        )
        ramp_s = 2 * math.pi / omega_rad_s
        begin_s = ramp_s + spec.settling_time_s
        times_s = np.arange(0, begin_s + max(2 * ramp_s, 6.0), spec.sample_time_s)
        envelope = 0.5 - 0.5 * np.cos(np.pi * np.minimum(times_s / ramp_s, 1.0))
        references = np.zeros((len(times_s), len(spec.axes)))
        references[:, axis] = amplitude * envelope * np.sin(omega_rad_s * times_s)
        outputs = robot.run(references)
        robot.rest()
        late = times_s >= begin_s
        phase = omega_rad_s * times_s[late]
        columns = np.stack([np.cos(phase), np.sin(phase), np.ones_like(phase), phase], axis=1)
        (c_y, s_y, *_), *_ = np.linalg.lstsq(columns, outputs[late, axis], rcond=None)
        (c_u, s_u, *_), *_ = np.linalg.lstsq(columns, references[late, axis], rcond=None)
        return complex((c_y - 1j * s_y) / (c_u - 1j * s_u))

    return measure


@pytest.fixture(scope="session")
def chordal() -> Callable[[complex, complex], float]:
    """Compute the chordal distance of two responses, the paper's Eq. (4)."""
    return lambda z_1, z_2: abs(z_1 - z_2) / math.sqrt((1 + abs(z_1) ** 2) * (1 + abs(z_2) ** 2))
