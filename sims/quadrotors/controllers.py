"""The two baseline position controllers: setpoints for firmware, attitude commands over a link."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

GRAVITY_M_S2 = 9.81

HOVER_HEIGHT_M = 1.0
"""Where every vehicle flies: clear of the floor, whose contact the simulator does model."""

HEIGHT_TIME_CONSTANT_S = 0.5
"""Of the on-board height hold of an attitude-commanded vehicle, critically damped."""


def firmware_setpoint(position: jax.Array, velocity: jax.Array) -> jax.Array:
    """Return crazyflow's full-state command for a horizontal position and velocity, each (2,)."""
    command = jnp.zeros(16).at[0:2].set(position).at[2].set(HOVER_HEIGHT_M)
    return command.at[3:5].set(velocity).at[12].set(1.0)  # no rotation: yaw stays zero


class GroundStation(NamedTuple):
    """The off-board controller's parameters and the attitude commands that are under way.

    `on_air` (ticks, 2) holds the wanted pitch and roll, the latest first; `link_ticks` of them have
    not arrived yet.
    """

    mass_kg: jax.Array
    stiffness_1_s2: jax.Array
    damping_1_s: jax.Array
    tilt_max_rad: jax.Array
    link_ticks: jax.Array
    on_air: jax.Array


def offboard_command(
    station: GroundStation,
    position: jax.Array,
    velocity: jax.Array,
    reference: jax.Array,
    reference_velocity: jax.Array,
    cos_tilt: jax.Array,
) -> tuple[GroundStation, jax.Array]:
    """Compute one control period of the off-board position loop and the on-board height hold.

    Args:
        station: the controller, with the commands under way.
        position: shape (3,), world frame.
        velocity: shape (3,).
        reference: horizontal position, shape (2,).
        reference_velocity: shape (2,).
        cos_tilt: cosine of the angle between thrust and vertical.

    Returns:
        The controller one period later, and what acts on board now: roll, pitch, yaw [rad] and
        thrust [N], shape (4,).
    """
    acceleration = station.stiffness_1_s2 * (reference - position[:2]) + station.damping_1_s * (
        reference_velocity - velocity[:2]
    )
    # At yaw zero a positive pitch accelerates along +x and a positive roll along −y.
    tilt = jnp.arctan(acceleration / GRAVITY_M_S2) * jnp.array([1.0, -1.0])
    wanted = jnp.clip(tilt, -station.tilt_max_rad, station.tilt_max_rad)
    on_air = jnp.concatenate([wanted[jnp.newaxis], station.on_air[:-1]])
    pitch, roll = on_air[station.link_ticks]
    lift = (
        GRAVITY_M_S2
        + (HOVER_HEIGHT_M - position[2]) / HEIGHT_TIME_CONSTANT_S**2
        - 2 / HEIGHT_TIME_CONSTANT_S * velocity[2]
    )
    thrust = station.mass_kg * lift / cos_tilt
    command = jnp.stack([roll, pitch, jnp.zeros_like(roll), thrust])
    return station._replace(on_air=on_air), command
