"""Air that resists a vehicle with the square of its airspeed, and moves in gusts."""

from __future__ import annotations

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp

from nufleet.sims.quadrotors.settings import CONTROL_HZ, Air

AIR_DENSITY_KG_M3 = 1.2
"""Density of dry air at 20 °C and 1013 hPa."""


class MovingAir(NamedTuple):
    """The air around one vehicle, constant over one control period; a JAX pytree."""

    drag_kg_m: jax.Array
    """Force per squared airspeed, ½ ρ C_D A."""

    persistence: jax.Array
    """Correlation of the wind with that of the control period before."""

    kick_m_s: jax.Array
    """Standard deviation of the wind's change that the period before does not explain."""

    wind_m_s: jax.Array
    """Wind in the world frame, shape (2,)."""

    key: jax.Array
    """Key of the random generator of the gusts."""


def moving_air(air: Air, seed: int) -> MovingAir:
    """Return the air as it is described, at rest for the moment.

    Args:
        air: Description of the air.
        seed: Seed of the gusts.
    """
    persistence = math.exp(-1 / (CONTROL_HZ * air.gust_time_s))
    return MovingAir(
        drag_kg_m=jnp.float32(AIR_DENSITY_KG_M3 / 2 * air.drag_area_m2),
        persistence=jnp.float32(persistence),
        kick_m_s=jnp.float32(air.gust_std_m_s * math.sqrt(1 - persistence**2)),
        wind_m_s=jnp.zeros(2),
        key=jax.random.PRNGKey(seed),
    )


def next_gust(air: MovingAir) -> MovingAir:
    """Return the air one control period later (the exact step of a Gauss-Markov process)."""
    key, now = jax.random.split(air.key)
    kick = air.kick_m_s * jax.random.normal(now, (2,))
    return air._replace(wind_m_s=air.persistence * air.wind_m_s + kick, key=key)


def drag_force(air: MovingAir, velocity_m_s: jax.Array) -> jax.Array:
    """Return the force of the air on a vehicle in N, shape (3,), in the world frame.

    Args:
        air: Air around the vehicle.
        velocity_m_s: Velocity of the vehicle in the world frame, shape (3,).
    """
    relative = velocity_m_s - jnp.append(air.wind_m_s, 0.0)
    return -air.drag_kg_m * jnp.linalg.norm(relative) * relative
