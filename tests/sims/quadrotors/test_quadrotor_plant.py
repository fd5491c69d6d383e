"""crazyflow's vehicle behind a simulated Crazyflie's firmware flies as the simulated robot does."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from nufleet.robot_agent.robot import Robot
from nufleet.sims.crazyflies.quadrotor_plant import QuadrotorPlant
from nufleet.sims.quadrotors.robot import Quadrotor


def test_it_follows_set_points_as_the_robot_does(fresh: Callable[[str], Robot]) -> None:
    robot = fresh("target")
    assert isinstance(robot, Quadrotor)
    flight, vehicle = robot.flown_by
    plant = QuadrotorPlant(flight, vehicle)
    references = 0.1 * np.sin(0.06 * np.arange(200))[:, np.newaxis] * [1.0, 0.5]
    _, track = flight.fly(vehicle, references)
    seen = []
    for reference in references:
        plant.follow(np.array([*reference, 0.5]), np.zeros(3), 0.011)
        plant.follow(np.array([*reference, 0.5]), np.zeros(3), 0.0091)
        seen.append(plant._after[:, 0])
    # 0.1 ms more than a sample each time: after 200 of them the plant has gone one sample further.
    assert np.array(seen)[:150] == pytest.approx(track.states[1:151, :, 0], abs=1e-6)
    assert plant.position_m[2] == pytest.approx(0.5, abs=0.01)
    plant.position_m = np.zeros(3)
    plant.velocity_m_s = np.zeros(3)
    assert plant.position_m[2] == 0.0
