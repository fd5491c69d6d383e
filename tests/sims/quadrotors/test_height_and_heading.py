"""A simulated Crazyflie whose height and heading are axes as well, tested on all four at once."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.robot_agent.robot import Robot
from nufleet.shared.frequency_test.frequency_response import estimate_frequency_response
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.shared.robots.drivers import RobotDriver
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.sims.quadrotors.driver import DRIVER
from nufleet.sims.quadrotors.settings import QuadrotorSettings

AXES = ("x", "y", "z", "yaw")


def response_of(robot: Robot) -> MatrixResponse:
    robot.connect()
    choice = first_look((0.2, 5.4), robot.spec, 11, 0.7, (0, 1, 2, 3))
    plan = plan_excitation(choice.excitation(*AXES), robot.spec, "robot")
    reference = reference_of(plan)
    response = estimate_frequency_response(reference, robot.run(reference), plan)
    robot.rest()
    assert response.quality.usable, response.quality.reasons
    assert response.matrix is not None
    return response.matrix


def test_a_heavier_crazyflie_differs_along_its_axes_and_not_about_them(
    fleet_file: Callable[[str], FleetFile],
    settings_of: Callable[[FleetFile, RobotDriver], dict[str, Any]],
) -> None:
    settings = settings_of(fleet_file("crazyflies_4_axes"), DRIVER)
    two = {name: settings[name] for name in ("target", "heavier")}
    robots = DRIVER.build(two, np.random.default_rng(0))
    spec = robots["target"].spec
    assert [(axis.name, axis.unit) for axis in spec.axes] == [
        *(("x", "m"), ("y", "m"), ("z", "m"), ("yaw", "rad")),
    ]
    assert spec.tracking is None  # its axes have two units
    target, heavier = (response_of(robots[name]) for name in ("target", "heavier"))
    for place, axis in enumerate(AXES):
        own = target.played_by == place
        z = target.rows[place].z[own]
        assert 0.9 < abs(z[0]) < 1.6, axis  # it follows a slow reference
        differs = np.abs(heavier.rows[place].z[own] - z).max()
        assert differs < 0.05 if axis == "yaw" else differs > 0.05, axis
        across = [target.rows[other].z[own] for other in range(4) if other != place]
        assert np.abs(across).max() < 0.05, axis


def test_a_vehicle_that_holds_its_height_on_board_has_no_such_axes() -> None:
    bebop = {
        "controller": "offboard_pd",
        "mass_kg": 0.5,
        "attitude_stiffness_1_s2": 200.0,
        "attitude_damping_1_s": 45.0,
        "drag_1_s": 0.3,
        "link_delay_s": 0.06,
        "time_constant_s": 0.6,
        "damping_ratio": 1.0,
        "tilt_max_rad": 0.5,
    }
    with pytest.raises(ValidationError, match="needs the controller 'mellinger'"):
        QuadrotorSettings.model_validate({"vehicle": bebop, "height_and_heading": {}})
