"""Trajectories that show a robot's whole dynamics, under its limits, and what a step shows."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from robot_agent.robot import Robot
from shared.arrays import FloatArray
from shared.errors import RobotError
from shared.robot_spec import AxisSpec, RobotSpec

_FADE_S = 2.0
_TONES = 8
_NOISES = 5.0  # standard errors that a step's answer must stand out by
_REPEATS = 20


@dataclass(frozen=True, eq=False)
class FlightRecord:
    """References (samples, axes) and the states before each acted, (samples, axes, states)."""

    references: FloatArray
    states: FloatArray


def rich_references(
    spec: RobotSpec, axes: tuple[AxisSpec, ...], duration_s: float, rng: np.random.Generator
) -> FloatArray:
    """Return references on every axis, shape (samples, axes), from rest to rest.

    Pieces of 15 s, each a sum of eight sinusoids with random phases and a band of its own: the
    slow ones reach the bound on amplitude or velocity, the fast ones that on acceleration.

    Args:
        spec: of the robot.
        axes: the limits to keep to, in the order of `spec.axes`; those of the spec bound a
            frequency test, tracking may be allowed more.
        duration_s: how long at least.
        rng: draws frequencies and phases.
    """
    pieces = max(4, math.ceil(duration_s / 15.0))
    samples = round(15.0 / spec.sample_time_s)
    highest = np.geomspace(max(1.0, 3 * spec.omega_min_rad_s), min(spec.omega_max_rad_s, 6.0), 4)
    return np.concatenate(
        [
            np.stack(
                [
                    _piece(axis, float(highest[i % 4]), samples, spec.sample_time_s, rng)
                    for axis in axes
                ],
                axis=1,
            )
            for i in range(pieces)
        ]
    )


def _piece(
    axis: AxisSpec, highest: float, samples: int, sample_time_s: float, rng: np.random.Generator
) -> FloatArray:
    time_s = np.arange(samples) * sample_time_s
    omegas = rng.uniform(0.3 * min(1.0, highest), highest, _TONES)
    phases = rng.uniform(0, 2 * np.pi, _TONES)
    weights = rng.uniform(0.5, 1.0, _TONES) / omegas
    fade = np.minimum(1.0, np.minimum(time_s, time_s[::-1]) / _FADE_S)
    fade = fade**3 * (10 - 15 * fade + 6 * fade**2)
    wave = fade * (weights @ np.sin(np.outer(omegas, time_s) + phases[:, np.newaxis]))
    speed = np.abs(np.diff(wave)).max() / sample_time_s
    acceleration = np.abs(np.diff(wave, 2)).max() / sample_time_s**2
    largest = min(
        axis.amplitude_max / np.abs(wave).max(),
        axis.velocity_max / speed,
        axis.acceleration_max / acceleration,
    )
    return np.asarray(wave * largest)


def fly_record(robot: Robot, references: FloatArray) -> FlightRecord:
    """Play references (samples, axes) step by step and keep every state; the robot ends at rest.

    Raises:
        RobotError: the robot failed, or measured a number that is not finite.
    """
    states = np.empty((*references.shape, max(1, len(robot.state_names))))
    for k, reference in enumerate(references):
        observed = robot.observe()
        output = robot.step(reference)
        states[k] = observed if observed.shape[1] else output[:, np.newaxis]
    robot.rest()
    if not np.isfinite(states).all():
        raise RobotError("the robot measured a number that is not finite")
    return FlightRecord(references, states)


def relative_degree(robot: Robot, column: int) -> int:
    """Measure after how many samples an axis answers to a step of its reference.

    Twenty steps up and down, each as high as the axis may move in one sample, averaged; the answer
    is the first mean that leaves the noise before the steps by five standard errors.

    Raises:
        RobotError: the robot failed, or nothing answered within its settling time.
    """
    spec = robot.spec
    axis = spec.axes[column]
    wait = max(4, math.ceil(max(spec.settling_time_s, 0.5) / 2 / spec.sample_time_s))
    height = min(axis.velocity_max * spec.sample_time_s, axis.amplitude_max)
    levels = np.repeat(np.arange(2 * _REPEATS + 1) % 2 * height, wait)
    references = np.zeros((len(levels), len(spec.axes)))
    references[:, column] = levels
    outputs = robot.run(references)[:, column]
    robot.rest()
    signs = np.where(np.arange(2 * _REPEATS) % 2 == 0, 1.0, -1.0)
    # Row i is the answer to step i, from the sample at which the reference changed.
    answers = outputs[wait:].reshape(2 * _REPEATS, wait) * signs[:, np.newaxis]
    before = outputs[wait - 1 : -1 : wait] * signs
    change = answers - before[:, np.newaxis]
    error = change.std(axis=0, ddof=1)[0] / math.sqrt(2 * _REPEATS)
    stands_out = change.mean(axis=0) > _NOISES * error + 1e-9 * height
    if not stands_out.any():
        raise RobotError(f"axis {axis.name} did not answer to steps of {height:g} {axis.unit}")
    return max(1, int(np.argmax(stands_out)))
