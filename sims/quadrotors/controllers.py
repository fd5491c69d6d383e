"""The two baseline position controllers: setpoints for firmware, attitude commands over a link."""

from __future__ import annotations

from typing import NamedTuple

import jax
import jax.numpy as jnp

GRAVITY_M_S2 = 9.81

HOVER_HEIGHT_M = 1.0
"""Height at which every vehicle flies, clear of the floor, whose contact the simulator models."""

HEIGHT_TIME_CONSTANT_S = 0.5
"""Time constant of the critically damped on-board height hold of an attitude-commanded vehicle."""


def firmware_setpoint(position: jax.Array, velocity: jax.Array) -> jax.Array:
    """Return crazyflow's full-state command for a position and its velocity.

    Args:
        position: Horizontal position in m, shape (2,), or that, the height above the hovering
            height in m and the heading in rad, shape (4,).
        velocity: Its change per second, in the same shape; the controller takes no rate of the
            heading.

    Returns:
        The command, shape (16,); for a horizontal position at the hovering height, heading along x.
    """
    command = jnp.zeros(16).at[0:2].set(position[:2]).at[2].set(HOVER_HEIGHT_M)
    command = command.at[3:5].set(velocity[:2]).at[12].set(1.0)
    if len(position) == 2:
        return command
    height, half = HOVER_HEIGHT_M + position[2], position[3] / 2
    command = command.at[2].set(height).at[5].set(velocity[2])
    return command.at[11].set(jnp.sin(half)).at[12].set(jnp.cos(half))


class GroundStation(NamedTuple):
    """The off-board controller's parameters, and the attitude commands still in transit."""

    mass_kg: jax.Array
    """Mass of the vehicle."""

    stiffness_1_s2: jax.Array
    """Gain from position error to wanted acceleration."""

    damping_1_s: jax.Array
    """Gain from velocity error to wanted acceleration."""

    tilt_max_rad: jax.Array
    """Largest tilt that is commanded about either axis."""

    link_ticks: jax.Array
    """Number of latest commands that have not arrived yet: the link's delay in control periods."""

    on_air: jax.Array
    """Wanted pitch and roll in rad, latest first, shape (ticks, 2)."""


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
        station: Controller, with the commands in transit.
        position: Position in the world frame in m, shape (3,).
        velocity: Velocity in the world frame in m/s, shape (3,).
        reference: Horizontal reference position in m, shape (2,).
        reference_velocity: Horizontal reference velocity in m/s, shape (2,).
        cos_tilt: Cosine of the angle between thrust and vertical.

    Returns:
        The controller one period later, and the command that acts on board now: roll, pitch, yaw
        [rad] and thrust [N], shape (4,).
    """
    # PD law in the horizontal plane, a = k (p_r − p) + d (v_r − v).
    acceleration = station.stiffness_1_s2 * (reference - position[:2]) + station.damping_1_s * (
        reference_velocity - velocity[:2]
    )
    # At yaw zero, a positive pitch accelerates along +x and a positive roll along −y.
    tilt = jnp.arctan(acceleration / GRAVITY_M_S2) * jnp.array([1.0, -1.0])
    wanted = jnp.clip(tilt, -station.tilt_max_rad, station.tilt_max_rad)
    on_air = jnp.concatenate([wanted[jnp.newaxis], station.on_air[:-1]])
    pitch, roll = on_air[station.link_ticks]
    # The height obeys z'' = (h − z)/τ² − (2/τ) z', critically damped; the division by the cosine
    # below makes up for the share of the thrust that the tilt takes from the vertical.
    lift = (
        GRAVITY_M_S2
        + (HOVER_HEIGHT_M - position[2]) / HEIGHT_TIME_CONSTANT_S**2
        - 2 / HEIGHT_TIME_CONSTANT_S * velocity[2]
    )
    thrust = station.mass_kg * lift / cos_tilt
    command = jnp.stack([roll, pitch, jnp.zeros_like(roll), thrust])
    return station._replace(on_air=on_air), command
