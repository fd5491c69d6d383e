"""crazyflow set up for one vehicle: its parameters, its limits, hovering at the origin."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from typing import Any

import jax.numpy as jnp
import mujoco
import numpy as np

from nufleet.sims.quadrotors.controllers import GRAVITY_M_S2, HOVER_HEIGHT_M, GroundStation
from nufleet.sims.quadrotors.flight import Flight, Plant, Step
from nufleet.sims.quadrotors.moving_air import moving_air
from nufleet.sims.quadrotors.settings import (
    CONTROL_HZ,
    LINK_TICKS,
    PHYSICS_HZ,
    AttitudeVehicle,
    MellingerVehicle,
    QuadrotorSettings,
)

# MuJoCo's JAX part prints which accelerators it did not find; stdout belongs to the program's own
# output.
with contextlib.redirect_stdout(io.StringIO()) as printed:
    from crazyflow.control.transform import motor_force2rotor_vel
    from crazyflow.sim import Sim
    from crazyflow.sim.pipeline import replace_fn
    from crazyflow.sim.sim import rotor_vel_limits

log = logging.getLogger(__name__)
log.debug("crazyflow: %s", printed.getvalue())

MOTOR_RATE_1_S = 10.0
"""Rate of the first-order lag of the thrust behind its command, 0.1 s on a Parrot; it affects only
the height."""

THRUST_TO_WEIGHT = 2.0
"""Largest thrust that a Parrot's height hold may command, as a multiple of the weight; far above
the thrust that tests need."""


class Hangar:
    """Builds plants; vehicles with the same dynamics and controller share one compiled program."""

    def __init__(self) -> None:
        self._simulators: dict[tuple[str, str], tuple[Any, Step]] = {}
        self._flights: dict[tuple[str, str, bool, int], Flight] = {}
        # Otherwise MuJoCo would write its warnings to a file in the working directory.
        mujoco.set_mju_user_warning(lambda message: log.debug("mujoco: %s", message))

    def plant(self, settings: QuadrotorSettings, rng: np.random.Generator) -> tuple[Flight, Plant]:
        """Return the program that flies a vehicle, and the vehicle in the air at the origin.

        Args:
            settings: Settings of the vehicle.
            rng: Generator that gives the gusts their seed; unused in air at rest.
        """
        vehicle = settings.vehicle
        if isinstance(vehicle, MellingerVehicle):
            simulator, step = self._simulator(vehicle.airframe, vehicle.dynamics, "state")
            data, station = _crazyflie(simulator, vehicle), None
            kind = (vehicle.dynamics, "state", settings.air is not None, settings.axes)
        else:
            # The airframe only provides the structure: every parameter that acts is replaced.
            simulator, step = self._simulator("cf2x_L250", "so_rpy_rotor_drag", "attitude")
            data, station = _attitude_vehicle(simulator, vehicle), _ground_station(vehicle)
            kind = ("so_rpy_rotor_drag", "attitude", settings.air is not None, settings.axes)
        position = data.states.pos.at[..., 2].set(HOVER_HEIGHT_M)
        data = data.replace(states=data.states.replace(pos=position))
        gain = jnp.float32(1.0 if settings.velocity_reference else 0.0)
        air = None
        if settings.air is not None:
            air = moving_air(settings.air, int(rng.integers(2**31)))
        plant = Plant(data, station, air, jnp.zeros(settings.axes), gain)
        if kind not in self._flights:
            self._flights[kind] = Flight(step, plant)
        return self._flights[kind], plant

    def _simulator(self, airframe: str, dynamics: str, control: str) -> tuple[Any, Step]:
        if (airframe, dynamics) not in self._simulators:
            with warnings.catch_warnings():
                warnings.filterwarnings("ignore", message="Attaching a spec")  # about saving it
                simulator = Sim(
                    drone=airframe,
                    dynamics=dynamics,
                    control=control,
                    freq=PHYSICS_HZ,
                    state_freq=CONTROL_HZ,
                )
            replace_fn(simulator.step_pipeline, _clip_thrust(dynamics), "clip_rotor_vel_cmd")
            self._simulators[airframe, dynamics] = simulator, simulator.build_step_fn()
        return self._simulators[airframe, dynamics]


def _crazyflie(simulator: Any, vehicle: MellingerVehicle) -> Any:
    data = simulator.data
    parameters = data.params.replace(mass=jnp.array([vehicle.mass_kg]))
    state = data.controls.state
    horizontal = jnp.array([1.0, 1.0, 0.0])
    gains = dict(state.params)
    gains["kp"] = gains["kp"] * (1 + (vehicle.kp_scale - 1) * horizontal)
    gains["kd"] = gains["kd"] * (1 + (vehicle.kd_scale - 1) * horizontal)
    controls = data.controls.replace(state=state.replace(params=gains))
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    hover = jnp.array(weight_n)
    if vehicle.dynamics == "first_principles":
        hover = motor_force2rotor_vel(hover / 4, parameters.rpm2thrust[0])
    rotors = jnp.broadcast_to(hover, data.states.rotor_vel.shape)
    limits = jnp.array(rotor_vel_limits(simulator.dynamics, simulator.drone))
    return data.replace(
        params=parameters,
        controls=controls,
        states=data.states.replace(rotor_vel=rotors),
        plugins={"rotor_limits": limits},
    )


def _attitude_vehicle(simulator: Any, vehicle: AttitudeVehicle) -> Any:
    data = simulator.data
    ones = jnp.ones(3)
    weight_n = vehicle.mass_kg * GRAVITY_M_S2
    parameters = data.params.replace(
        mass=jnp.array([vehicle.mass_kg]),
        rpy_coef=-vehicle.attitude_stiffness_1_s2 * ones,
        rpy_rates_coef=-vehicle.attitude_damping_1_s * ones,
        cmd_rpy_coef=vehicle.attitude_stiffness_1_s2 * ones,
        drag_matrix=-vehicle.drag_1_s * vehicle.mass_kg * jnp.eye(3),
        thrust_dyn_coef=jnp.array([MOTOR_RATE_1_S]),
        acc_coef=jnp.zeros(1),
        cmd_f_coef=jnp.ones(1),
    )
    rotors = jnp.full(data.states.rotor_vel.shape, weight_n)
    return data.replace(
        params=parameters,
        states=data.states.replace(rotor_vel=rotors),
        plugins={"rotor_limits": jnp.array([0.0, THRUST_TO_WEIGHT * weight_n])},
    )


def _ground_station(vehicle: AttitudeVehicle) -> GroundStation:
    return GroundStation(
        mass_kg=jnp.float32(vehicle.mass_kg),
        stiffness_1_s2=jnp.float32(vehicle.time_constant_s**-2),
        damping_1_s=jnp.float32(2 * vehicle.damping_ratio / vehicle.time_constant_s),
        tilt_max_rad=jnp.float32(vehicle.tilt_max_rad),
        link_ticks=jnp.int32(vehicle.link_ticks),
        on_air=jnp.zeros((LINK_TICKS, 2)),
    )


def _clip_thrust(dynamics: str) -> Any:
    """Return a pipeline stage that limits the rotor command to the plant's own limits.

    crazyflow's own stage has the airframe's limits compiled in, which would keep vehicles from
    sharing a program. Limited are the rotor speeds [rpm] with first principles, and the collective
    thrust [N] with the other dynamics.
    """

    def clip(data: Any) -> Any:
        lower, upper = data.plugins["rotor_limits"]
        controls = data.controls
        if dynamics == "first_principles":
            rotors = jnp.clip(controls.rotor_vel, lower, upper)
            return data.replace(controls=controls.replace(rotor_vel=rotors))
        attitude = controls.attitude
        command = attitude.cmd.at[..., -1].set(jnp.clip(attitude.cmd[..., -1], lower, upper))
        attitude = attitude.replace(cmd=command)
        return data.replace(controls=controls.replace(attitude=attitude))

    return clip
