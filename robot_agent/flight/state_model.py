"""How the states that a robot measures beside its output follow from the output's motion.

Each is taken as a multiple of the output's velocity and acceleration: a velocity is the first, and
the tilt of a vehicle that flies is nearly proportional to the second. Nothing but a rehearsal uses
this, so that it may fly with inverse models that are fed with these states.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Name, NonNegative, Strict

_REACH_RAD = 1.5  # to either side of an observation, as a phase of the fastest motion
_DEGREE = 4  # of the polynomial through the outputs there, which follows such a motion within 3 %
_OBSERVATIONS_MIN = 8  # fewer do not tell two gains from noise
_QUOTIENT_S = 0.1  # over which a velocity is taken to be measured before one was observed


class StateEvidence(Strict):
    """Observations of the further states of one axis, as sums over products."""

    names: tuple[Name, ...]
    """Names of the states, without the output."""
    normal: Annotated[tuple[float, ...], Field(min_length=4, max_length=4)]
    """Products of the output's velocity and acceleration with each other, row by row."""
    right: tuple[float, ...]
    """Products of every state with the velocity and the acceleration, two numbers per state."""
    squares: tuple[NonNegative, ...]
    """Square of every state."""
    observations: Annotated[int, Field(ge=1)]
    """Number of observations that are added up."""
    noise_squares: tuple[NonNegative, ...]
    """Sixth of the square of every state's second difference, whose mean is the variance of noise
    that is new at each sample."""
    noise_runs: Annotated[int, Field(ge=0)]
    """Number of second differences."""

    @model_validator(mode="after")
    def _shapes_agree(self) -> StateEvidence:
        states = len(self.names)
        if (len(self.right), len(self.squares), len(self.noise_squares)) != (
            2 * states,
            states,
            states,
        ):
            raise ValueError("two products and two squares belong to each state")
        return self

    def __add__(self, other: StateEvidence) -> StateEvidence:
        """Return the evidence of both; the newer alone if they are of other states."""
        if self.names != other.names:
            return other
        return StateEvidence(
            names=self.names,
            normal=_sum(self.normal, other.normal),
            right=_sum(self.right, other.right),
            squares=_sum(self.squares, other.squares),
            observations=self.observations + other.observations,
            noise_squares=_sum(self.noise_squares, other.noise_squares),
            noise_runs=self.noise_runs + other.noise_runs,
        )


def state_evidence(
    names: tuple[str, ...],
    outputs: FloatArray,
    states: FloatArray,
    sample_time_s: float,
    omega_max_rad_s: float,
) -> StateEvidence | None:
    """Return what a motion shows of the further states of one axis; None if nothing.

    Args:
        names: Names of all states, the output first.
        outputs: Outputs measured, shape (samples,), in the axis's unit.
        states: All states, shape (samples, states); NaN where they were not observed.
        sample_time_s: Time between samples.
        omega_max_rad_s: Highest frequency in the motion.
    """
    reach = max(_DEGREE, round(_REACH_RAD / (omega_max_rad_s * sample_time_s)))
    seen = np.flatnonzero(np.isfinite(states).all(axis=1))
    seen = seen[(seen >= reach) & (seen < len(outputs) - reach)]
    if len(names) < 2 or not len(seen):
        return None
    near = np.arange(-reach, reach + 1)
    fit = np.linalg.pinv(np.vander(near / reach, _DEGREE + 1, increasing=True))
    scale = np.array([1.0, 2.0]) / (reach * sample_time_s) ** np.array([1, 2])
    moved = outputs[seen[:, np.newaxis] + near] @ fit[1:3].T * scale
    others = states[seen, 1:]
    # What is smooth hardly has a second difference from one sample to the next; noise has one.
    differences = np.diff(states[:, 1:], 2, axis=0)
    differences = differences[np.isfinite(differences).all(axis=1)]
    return StateEvidence(
        names=tuple(names[1:]),
        normal=tuple((moved.T @ moved).ravel().tolist()),
        right=tuple((others.T @ moved).ravel().tolist()),
        squares=tuple(np.sum(others**2, axis=0).tolist()),
        observations=len(seen),
        noise_squares=tuple((np.sum(differences**2, axis=0) / 6).tolist()),
        noise_runs=len(differences),
    )


@dataclass(frozen=True, eq=False)
class StateModel:
    """The states that a robot's output allows to rehearse."""

    names: tuple[str, ...]
    """Names of these states, the output first; those that nothing is known of, and all that follow
    one, are left out."""
    gains: FloatArray
    """Velocity and acceleration of the output in every state, shape (axes, states, 2)."""
    noise_std: FloatArray
    """Standard deviation of the noise of every state, shape (axes, states); 0 for the output."""


def state_model(
    names: tuple[str, ...],
    evidence: Mapping[str, StateEvidence],
    axes: Sequence[str],
    output_noise_std: Sequence[float],
) -> StateModel:
    """Return how a robot's states follow from its outputs.

    An axis without observations is like the others.

    Args:
        names: Names of all states that the robot measures, the output first; maybe none.
        evidence: Evidence of each axis, by its name.
        axes: Names of the axes.
        output_noise_std: Standard deviation of each axis's output, by which a velocity that was
            never observed is taken to be as noisy as a difference quotient.
    """
    found: list[FloatArray] = []
    for axis, noise_std in zip(axes, output_noise_std, strict=True):
        own = evidence.get(axis)
        several = [own] if own is not None else list(evidence.values())
        fitting = [one for one in several if one.names == names[1:]]
        rows = [np.zeros(3)]
        for i, name in enumerate(names[1:]):
            row = _fitted(fitting, i)
            if row is None and name == "velocity":
                row = np.array([1.0, 0.0, noise_std / _QUOTIENT_S])
            if row is None:
                break
            rows.append(row)
        found.append(np.stack(rows))
    known = min(len(rows) for rows in found)
    together = np.stack([rows[:known] for rows in found])
    return StateModel(names[:known], together[:, :, :2], together[:, :, 2])


def _fitted(several: Sequence[StateEvidence], state: int) -> FloatArray | None:
    """Return both gains and the noise of a state, shape (3,); None from too few observations."""
    count = sum(one.observations for one in several)
    if count < _OBSERVATIONS_MIN:
        return None
    normal = np.sum([one.normal for one in several], axis=0).reshape(2, 2)
    right = np.sum([one.right[2 * state : 2 * state + 2] for one in several], axis=0)
    squares = sum(one.squares[state] for one in several)
    gains = np.linalg.lstsq(normal, right, rcond=1e-9)[0]
    noise = max(0.0, float(squares - gains @ right)) / (count - 2)
    runs = sum(one.noise_runs for one in several)
    if runs:
        # Not all that is left is noise: these two gains are not all that there is to a state.
        noise = min(noise, sum(one.noise_squares[state] for one in several) / runs)
    return np.append(gains, np.sqrt(noise))


def _sum(first: tuple[float, ...], second: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(a + b for a, b in zip(first, second, strict=True))
