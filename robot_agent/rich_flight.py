"""References that show a robot's whole dynamics, under its limits, and its delay."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_agent.robot import Robot
from shared.arrays import FloatArray
from shared.errors import RobotError
from shared.robot_spec import RobotSpec, TrackingLimits

_FADE_S = 2.0
_TONES = 8
STEPS_UP = 20


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """References (samples, axes) and the states before each acted, (samples, axes, states)."""

    references: FloatArray
    states: FloatArray


def rich_references(spec: RobotSpec, duration_s: float, rng: np.random.Generator) -> FloatArray:
    """Return references on every axis, shape (samples, axes), from rest to rest.

    Pieces of 15 s, each a sum of eight sinusoids with random phases and a band of its own: the
    slow ones reach the bound on position or speed, the fast ones that on acceleration.

    Args:
        spec: of the robot; its tracking limits are kept to.
        duration_s: how long at least.
        rng: draws frequencies and phases.

    Raises:
        RobotError: the robot does not track.
    """
    limits = spec.tracking
    if limits is None:
        raise RobotError("a robot without tracking limits makes no rich flight")
    pieces = max(4, math.ceil(duration_s / 15.0))
    samples = round(15.0 / spec.sample_time_s)
    highest = np.geomspace(max(1.0, 3 * spec.omega_min_rad_s), min(spec.omega_max_rad_s, 6.0), 4)
    return np.concatenate(
        [
            _piece(limits, len(spec.axes), float(highest[i % 4]), samples, spec.sample_time_s, rng)
            for i in range(pieces)
        ]
    )


def _piece(
    limits: TrackingLimits,
    axes: int,
    highest: float,
    samples: int,
    sample_time_s: float,
    rng: np.random.Generator,
) -> FloatArray:
    """Return a piece of shape (samples, axes) that reaches one of the limits."""
    waves = np.stack([_wave(highest, samples, sample_time_s, rng) for _ in range(axes)], axis=1)
    waves /= np.abs(np.diff(waves, axis=0)).max(axis=0)  # alike in speed
    speed = np.linalg.norm(np.diff(waves, axis=0), axis=1).max() / sample_time_s
    acceleration = np.linalg.norm(np.diff(waves, 2, axis=0), axis=1).max() / sample_time_s**2
    largest = min(
        limits.position_max / np.abs(waves).max(),
        limits.speed_max / speed,
        limits.acceleration_max / acceleration,
    )
    return np.asarray(waves * largest)


def _wave(
    highest: float, samples: int, sample_time_s: float, rng: np.random.Generator
) -> FloatArray:
    time_s = np.arange(samples) * sample_time_s
    omegas = rng.uniform(0.3 * min(1.0, highest), highest, _TONES)
    phases = rng.uniform(0, 2 * np.pi, _TONES)
    weights = rng.uniform(0.5, 1.0, _TONES) / omegas
    fade = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / _FADE_S)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    return np.asarray(fade * (weights @ np.sin(np.outer(omegas, time_s) + phases[:, np.newaxis])))


def fly_record(robot: Robot, references: FloatArray) -> FlightRecord:
    """Play references (samples, axes) step by step and keep every state; the robot ends at rest.

    Raises:
        RobotError: the robot failed, or measured a number that is not finite; it may be moving.
    """
    states = np.empty((*references.shape, max(1, len(robot.state_names))))
    for k, reference in enumerate(references):
        observed = robot.observe()
        output = robot.step(reference)
        states[k] = observed if observed.shape[1] else output[:, np.newaxis]
        if not np.isfinite(states[k]).all():
            raise RobotError(f"the sensor returned a number that is not finite at sample {k}")
    robot.rest()
    return FlightRecord(references, states)


def step_references(spec: RobotSpec, column: int) -> FloatArray:
    """Return steps up and down on one axis, shape (samples, axes).

    Twenty of each, as high as the axis may move in one sample.
    """
    axis = spec.axes[column]
    wait = max(4, math.ceil(max(spec.settling_time_s, 0.5) / 2 / spec.sample_time_s))
    height = min(axis.velocity_max * spec.sample_time_s, axis.amplitude_max)
    references = np.zeros(((2 * STEPS_UP + 1) * wait, len(spec.axes)))
    references[:, column] = np.repeat(np.arange(2 * STEPS_UP + 1) % 2 * height, wait)
    return references
