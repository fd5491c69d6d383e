"""A compiled program that flies a vehicle through any number of samples, chunk by chunk."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.sims.quadrotors.controllers import (
    HOVER_HEIGHT_M,
    GroundStation,
    firmware_setpoint,
    offboard_command,
)
from nufleet.sims.quadrotors.moving_air import MovingAir, drag_force, next_gust
from nufleet.sims.quadrotors.settings import CONTROL_HZ, PHYSICS_HZ, SAMPLE_TIME_S

CHUNK_SAMPLES = 256
"""Largest number of samples that one call of the compiled program can play."""

TICKS_PER_SAMPLE = round(SAMPLE_TIME_S * CONTROL_HZ)
STEPS_PER_TICK = PHYSICS_HZ // CONTROL_HZ

Step = Callable[[Any, int], Any]


class Plant(NamedTuple):
    """One robot in flight, with its state and its parameters; a JAX pytree."""

    data: Any
    """crazyflow's data: state, controls and parameters of the vehicle."""

    station: GroundStation | None
    """Off-board controller; None for a vehicle that takes full-state setpoints."""

    air: MovingAir | None
    """Air that resists the vehicle; None for air at rest."""

    reference: jax.Array
    """Last reference in m, shape (2,); of four axes, with the height in m and the heading in rad,
    shape (4,)."""

    velocity_gain: jax.Array
    """1 if the velocity of the reference is sent along with it, else 0."""


class Track(NamedTuple):
    """The motion of a vehicle: its states, and the signals that reveal a crash."""

    states: FloatArray
    """Position [m], velocity [m/s] and tilt [rad] along x and y, shape (samples + 1, 2, 3).

    The tilt is the thrust's, and positive where it accelerates the vehicle along the axis. Where
    height and heading are axes, too, shape (samples + 1, 4, 3), with the height above the hovering
    height, the heading [rad], their changes per second, and no tilt."""

    height_m: FloatArray
    """Height, shape (samples + 1,)."""

    cos_tilt: FloatArray
    """Cosine of the angle between thrust and vertical, shape (samples + 1,)."""


class Flight:
    """The compiled program of one kind of vehicle; parameters may differ from plant to plant.

    The number of samples is an argument of the program and not part of its shape. One compilation
    therefore serves every length, and `step` and `run` execute the same instructions.
    """

    def __init__(self, step: Step, example: Plant) -> None:
        """Compile the program.

        Args:
            step: crazyflow's function that advances its data by a number of physics steps.
            example: Plant with the structure of those to fly.
        """

        def advance(
            plant: Plant, references: jax.Array, count: jax.Array
        ) -> tuple[Plant, jax.Array]:
            def body(k: jax.Array, carry: tuple[Plant, jax.Array]) -> tuple[Plant, jax.Array]:
                plant, rows = carry
                plant = _sample(step, plant, references[k])
                return plant, rows.at[k + 1].set(_row(plant))

            row = _row(plant)
            rows = jnp.zeros((CHUNK_SAMPLES + 1, len(row))).at[0].set(row)
            moved: tuple[Plant, jax.Array] = jax.lax.fori_loop(0, count, body, (plant, rows))
            return moved

        self._axes = len(example.reference)
        references = jnp.zeros((CHUNK_SAMPLES, self._axes))
        self._advance = jax.jit(advance).lower(example, references, jnp.int32(0)).compile()

    def fly(self, plant: Plant, references: FloatArray) -> tuple[Plant, Track]:
        """Fly a plant along references.

        Args:
            plant: Plant at the beginning.
            references: References of all axes, shape (samples, axes), at least one sample.

        Returns:
            The plant after the last reference has acted, and its track.
        """
        pieces = []
        for first in range(0, len(references), CHUNK_SAMPLES):
            piece = references[first : first + CHUNK_SAMPLES]
            padded = np.zeros((CHUNK_SAMPLES, self._axes), dtype=np.float32)
            padded[: len(piece)] = piece
            plant, rows = self._advance(plant, padded, np.int32(len(piece)))
            pieces.append(np.asarray(rows, dtype=np.float64)[: len(piece) + 1])
        rows = np.concatenate([*(piece[:-1] for piece in pieces), pieces[-1][-1:]])
        states = rows[:, :-2].reshape(len(rows), self._axes, 3)
        return plant, Track(states, rows[:, -2], rows[:, -1])


def _sample(step: Step, plant: Plant, reference: jax.Array) -> Plant:
    velocity = plant.velocity_gain * (reference - plant.reference) / SAMPLE_TIME_S
    plant = plant._replace(reference=reference)
    for _ in range(TICKS_PER_SAMPLE):
        plant = _in_air(plant)
        plant = _command(plant, reference, velocity)
        plant = plant._replace(data=step(plant.data, STEPS_PER_TICK))
    return plant


def _in_air(plant: Plant) -> Plant:
    if plant.air is None:
        return plant
    air, states = next_gust(plant.air), plant.data.states
    force = jnp.broadcast_to(drag_force(air, states.vel[0, 0]), states.force.shape)
    data = plant.data.replace(states=states.replace(force=force))
    return plant._replace(data=data, air=air)


def _command(plant: Plant, reference: jax.Array, velocity: jax.Array) -> Plant:
    controls = plant.data.controls
    if plant.station is None:
        setpoint = firmware_setpoint(reference, velocity)[jnp.newaxis, jnp.newaxis]
        controls = controls.replace(state=controls.state.replace(staged_cmd=setpoint))
        return plant._replace(data=plant.data.replace(controls=controls))
    states = plant.data.states
    station, command = offboard_command(
        plant.station,
        states.pos[0, 0],
        states.vel[0, 0],
        reference,
        velocity,
        _thrust_axis(plant)[2],
    )
    staged = controls.attitude.replace(staged_cmd=command[jnp.newaxis, jnp.newaxis])
    data = plant.data.replace(controls=controls.replace(attitude=staged))
    return plant._replace(data=data, station=station)


def _row(plant: Plant) -> jax.Array:
    position, velocity = plant.data.states.pos[0, 0], plant.data.states.vel[0, 0]
    thrust = _thrust_axis(plant)
    tilt = jnp.arctan2(thrust[:2], thrust[2])
    states = jnp.stack([position[:2], velocity[:2], tilt], axis=1)
    if len(plant.reference) == 4:
        rate = plant.data.states.ang_vel[0, 0, 2]
        height = jnp.stack([position[2] - HOVER_HEIGHT_M, velocity[2], jnp.zeros_like(rate)])
        heading = jnp.stack([_heading(plant), rate, jnp.zeros_like(rate)])
        states = jnp.concatenate([states, height[jnp.newaxis], heading[jnp.newaxis]])
    return jnp.concatenate([states.ravel(), position[2:], thrust[2:]])


def _heading(plant: Plant) -> jax.Array:
    """Return the angle in rad by which the body's x axis is turned from that of the world."""
    x, y, z, w = plant.data.states.quat[0, 0]
    return jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z))


def _thrust_axis(plant: Plant) -> jax.Array:
    """Return the body's z axis in the world frame, from the quaternion (x, y, z, w)."""
    x, y, z, w = plant.data.states.quat[0, 0]
    return jnp.stack([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])
