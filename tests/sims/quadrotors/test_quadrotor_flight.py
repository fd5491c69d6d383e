"""The compiled flight does what crazyflow and the vehicles' equations say, however it is cut."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.signal import cont2discrete

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.models.linear_model import LinearModel
from nufleet.sims.quadrotors.controllers import GRAVITY_M_S2
from nufleet.sims.quadrotors.robot import Quadrotor
from nufleet.sims.quadrotors.settings import AttitudeVehicle, QuadrotorSettings
from nufleet.sims.quadrotors.simulator import Hangar


def wandering(samples: int, seed: int = 5) -> FloatArray:
    """A smooth random reference on both axes, within 0.2 m."""
    rng = np.random.default_rng(seed)
    times_s = np.arange(samples) * 0.02
    rates = rng.uniform(0.3, 3.0, size=(4, 2))
    return np.asarray(0.05 * np.sin(times_s[:, np.newaxis, np.newaxis] * rates).sum(axis=1))


@pytest.mark.parametrize("name", ["target", "source-2", "source-3"])
def test_however_a_signal_is_cut_the_outputs_are_the_same_to_the_bit(
    name: str, fresh: Callable[[str], Robot]
) -> None:
    robot = fresh(f"quiet-{name}")
    references = wandering(600)
    whole = robot.run(references)
    after = robot.observe()
    robot = fresh(f"quiet-{name}")
    single = [robot.step(reference) for reference in references[:40]]
    pieces = [robot.run(piece) for piece in np.split(references[40:], [1, 257, 300])]
    np.testing.assert_array_equal(np.concatenate([single, *pieces]), whole)
    np.testing.assert_array_equal(robot.observe(), after)


def test_the_compiled_flight_is_crazyflows_own_stepping(
    built: Mapping[str, Robot],
) -> None:
    references = wandering(150)
    robot = built["target"]
    assert isinstance(robot, Quadrotor)
    _, track = robot._flight.fly(robot._fresh_plant, references)

    simulator: Any = Hangar()._simulator("cf2x_L250", "first_principles", "state")[0]
    simulator.data = robot._fresh_plant.data
    before, positions = np.zeros(2), []
    for reference in references:
        positions.append(np.asarray(simulator.data.states.pos)[0, 0, :2])
        command = np.zeros((1, 1, 16))
        command[0, 0, [0, 1, 2]] = [*reference, 1.0]
        command[0, 0, [3, 4]] = (reference - before) / 0.02
        command[0, 0, 12] = 1.0
        for _ in range(2):
            simulator.state_control(jnp.asarray(command, dtype=jnp.float32))
            simulator.step(5)
        before = reference
    np.testing.assert_allclose(track.states[:-1, :, 0], positions, atol=1e-5)


def linear_loop(settings: QuadrotorSettings) -> LinearModel:
    """Return the small-signal loop of an attitude-commanded vehicle, sampled as it is flown."""
    vehicle = settings.vehicle
    assert isinstance(vehicle, AttitudeVehicle)
    a_c = np.zeros((4, 4))  # position, velocity, tilt, tilt rate
    a_c[0, 1] = a_c[2, 3] = 1.0
    a_c[1, 1:3] = -vehicle.drag_1_s, GRAVITY_M_S2
    a_c[3, 2:] = -vehicle.attitude_stiffness_1_s2, -vehicle.attitude_damping_1_s
    b_c = np.array([[0.0], [0.0], [0.0], [vehicle.attitude_stiffness_1_s2]])
    a_d, b_d, *_ = cont2discrete((a_c, b_c, np.eye(1, 4), np.zeros((1, 1))), 0.01)
    k_p = vehicle.time_constant_s**-2 / GRAVITY_M_S2
    k_d = 2 * vehicle.damping_ratio / vehicle.time_constant_s / GRAVITY_M_S2

    def sample(x: FloatArray, u: float) -> FloatArray:
        """Advance state, commands under way (latest first) and last reference by 20 ms."""
        body, under_way, last = x[:4], x[4:-1], x[-1]
        for _ in range(2):
            command = k_p * (u - body[0]) + k_d * ((u - last) / 0.02 - body[1])
            under_way = np.append(command, under_way)
            body = a_d @ body + b_d[:, 0] * under_way[-1]
            under_way = under_way[:-1]
        return np.concatenate([body, under_way, [u]])

    order = 5 + vehicle.link_ticks
    a = np.stack([sample(unit, 0.0) for unit in np.eye(order)], axis=1)
    return LinearModel(
        a=tuple(map(tuple, a.tolist())),
        b=tuple(sample(np.zeros(order), 1.0).tolist()),
        c=(1.0, *[0.0] * (order - 1)),
        sample_time_s=0.02,
    )


@pytest.mark.parametrize("name", ["source-3", "source-4", "source-5"])
@pytest.mark.parametrize("axis", [0, 1])
def test_an_attitude_commanded_vehicle_responds_as_its_linear_loop(
    name: str,
    axis: int,
    paper_settings: dict[str, QuadrotorSettings],
    fresh: Callable[[str], Robot],
    respond: Callable[[Robot, float, int], complex],
    chordal: Callable[[complex, complex], float],
) -> None:
    omegas = np.array([0.4, 1.5, 3.0, 5.4])
    expected: ComplexArray = linear_loop(paper_settings[name]).frequency_response(omegas)
    for omega, z in zip(omegas, expected, strict=True):
        measured = respond(fresh(f"quiet-{name}"), float(omega), axis)
        assert chordal(measured, complex(z)) < 0.02, (omega, measured, z)


def test_the_loop_of_the_oracle_has_the_gain_one_at_rest(
    paper_settings: dict[str, QuadrotorSettings],
) -> None:
    z = linear_loop(paper_settings["source-3"]).frequency_response(np.array([1e-4]))
    assert abs(z[0] - 1) < 1e-3
    assert math.isclose(abs(z[0]), 1.0, abs_tol=1e-6)
