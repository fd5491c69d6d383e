"""Linear loops that are coupled by their inertia, as by a payload off centre, with known Z(ω)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, model_validator
from scipy.linalg import expm

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.models.transfer_models import StateSpace
from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
from nufleet.shared.strict import Name, NonNegative, Positive, Strict
from nufleet.sims.measurement_noise import MeasurementNoise
from nufleet.sims.simulated_robot import RestRule, SimulatedRobot

SETTLED = 1e-3
"""Share to which the slowest mode has decayed when a transient counts as negligible."""

REST = 1e-3
"""Largest position in m or rad, and its change per second, at rest."""

Values = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=8)]


class AxisLimits(Strict):
    """Unit of an axis, and its limits on frequency tests."""

    unit: Literal["m", "rad"] = "m"
    """Unit of its position."""
    amplitude_max: Positive
    """Largest amplitude, in its unit."""
    velocity_max: Positive
    """Largest velocity of the reference, in its unit per second."""
    acceleration_max: Positive
    """Largest acceleration of the reference, in its unit per second squared."""


class CoupledLoopsSettings(Strict):
    """Parameters of one robot with loops M q̈ + 2 ζ ω₀ q̇ + ω₀² (q − r) = 0, M with ones on its
    diagonal.
    """

    natural_frequency_rad_s: Values
    """Natural frequency ω₀ of each axis's loop by itself."""
    damping_ratio: Values
    """Damping ratio ζ of each axis's loop by itself."""
    coupling: tuple[float, ...] = ()
    """Entries of M above its diagonal, row by row; none for loops that are not coupled."""
    axes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=8)] = ("x", "y")
    """Names of the axes, which move in m unless `limits` says otherwise."""
    limits: dict[Name, AxisLimits] = {}  # noqa: RUF012 (pydantic copies it)
    """Unit and limits of single axes, by axis, in place of those below. A robot whose axes differ
    in their units takes frequency tests only, and no paths."""
    alone: tuple[Name, ...] = ()
    """Axes that may not move at the same time as another in a test."""
    noise_std_m: NonNegative = 0.0
    """Standard deviation of the white noise of every measured position."""
    sample_time_s: Positive = 0.02
    """Sample time."""
    amplitude_max_m: Positive = 0.5
    """Largest amplitude of a frequency test on each axis."""
    velocity_max_m_s: Positive = 1.0
    """Largest velocity of a frequency test's reference on each axis."""
    acceleration_max_m_s2: Positive = 4.0
    """Largest acceleration of a frequency test's reference on each axis."""
    omega_min_rad_s: Positive = 0.05
    """Lower edge of the band for frequency tests."""
    omega_max_rad_s: Positive = 20.0
    """Upper edge of the band for frequency tests."""
    duration_max_s: Annotated[float, Field(gt=0, le=86_400)] = 1800.0
    """Longest motion that the robot accepts."""

    @model_validator(mode="after")
    def _shapes_agree(self) -> CoupledLoopsSettings:
        count = len(self.axes)
        for name in ("natural_frequency_rad_s", "damping_ratio"):
            if len(getattr(self, name)) != count:
                raise ValueError(f"{name} needs {count} values, one for each of the axes")
        pairs = count * (count - 1) // 2
        if len(self.coupling) not in (0, pairs):
            raise ValueError(f"coupling needs {pairs} values, one for each pair of axes")
        if unknown := set(self.limits) - set(self.axes):
            raise ValueError(
                f"limits of {', '.join(sorted(unknown))}, which are not among the axes"
            )
        if np.linalg.eigvalsh(self.inertia)[0] < 1e-3:
            raise ValueError("the inertia matrix is not positive definite: couple the axes less")
        return self

    @property
    def axis_limits(self) -> tuple[AxisLimits, ...]:
        """Unit and limits of every axis."""
        usual = AxisLimits(
            amplitude_max=self.amplitude_max_m,
            velocity_max=self.velocity_max_m_s,
            acceleration_max=self.acceleration_max_m_s2,
        )
        return tuple(self.limits.get(axis, usual) for axis in self.axes)

    @property
    def inertia(self) -> FloatArray:
        """The inertia matrix M, shape (axes, axes)."""
        matrix = np.eye(len(self.axes))
        if self.coupling:
            above = np.triu_indices(len(self.axes), 1)
            matrix[above] = matrix.T[above] = self.coupling
        return matrix


def closed_loops(settings: CoupledLoopsSettings) -> StateSpace:
    """Return the model from all references to all outputs, with the state (q, q̇).

    References are held between samples, so that the model in discrete time is exact:
    [A_d, B_d; 0, I] = exp([A, B; 0, 0] T).
    """
    omega, zeta = np.array(settings.natural_frequency_rad_s), np.array(settings.damping_ratio)
    count, step_s = len(omega), settings.sample_time_s
    stiffness = np.linalg.solve(settings.inertia, np.diag(omega**2))
    damping = np.linalg.solve(settings.inertia, np.diag(2 * zeta * omega))
    both = np.zeros((3 * count, 3 * count))
    both[:count, count : 2 * count] = np.eye(count)
    both[count : 2 * count] = np.hstack([-stiffness, -damping, stiffness])
    stepped = expm(both * step_s)
    states = 2 * count
    return StateSpace(
        stepped[:states, :states],
        stepped[:states, states:],
        np.eye(count, states),
        np.zeros((count, count)),
        step_s,
    )


class CoupledLoops(SimulatedRobot):
    """A robot whose axes pull at each other; it runs as fast as it can."""

    def __init__(self, name: str, settings: CoupledLoopsSettings, rng: np.random.Generator) -> None:
        count = len(settings.axes)
        sigma = np.tile([settings.noise_std_m, 0.0], (count, 1))
        rule = RestRule(settings.velocity_max_m_s / 2, REST, REST, patience_s=600.0)
        noise = MeasurementNoise(sigma, rng)
        super().__init__(name, _spec_of(settings), ("position", "velocity"), noise, rule)
        self.model = closed_loops(settings)
        """Exact model from all references to all outputs."""

    def _start(self) -> FloatArray:
        return np.zeros((len(self.spec.axes), 2))

    def _play(self, references: FloatArray) -> FloatArray:
        a, driven = self.model.a, references @ self.model.b.T
        states = np.empty((len(references) + 1, len(a)))
        states[0] = self._ready().T.ravel()
        for k, drive in enumerate(driven):
            states[k + 1] = a @ states[k] + drive
        return np.moveaxis(states.reshape(len(states), 2, -1), 1, 2)


def _spec_of(settings: CoupledLoopsSettings) -> RobotSpec:
    model = closed_loops(settings)
    slowest = float(np.max(np.abs(model.modes)))
    a = tuple(map(tuple, model.a.tolist()))
    return RobotSpec(
        kind="coupled-loops",
        axes=tuple(
            AxisSpec(
                name=name,
                unit=limits.unit,
                amplitude_max=limits.amplitude_max,
                velocity_max=limits.velocity_max,
                acceleration_max=limits.acceleration_max,
                together=name not in settings.alone,
                model=LinearModel(
                    a=a,
                    b=tuple(model.b[:, place].tolist()),
                    c=tuple(model.c[place].tolist()),
                    sample_time_s=settings.sample_time_s,
                ),
            )
            for place, (name, limits) in enumerate(
                zip(settings.axes, settings.axis_limits, strict=True)
            )
        ),
        sample_time_s=settings.sample_time_s,
        omega_min_rad_s=settings.omega_min_rad_s,
        omega_max_rad_s=settings.omega_max_rad_s,
        duration_max_s=settings.duration_max_s,
        settling_time_s=math.ceil(math.log(SETTLED) / math.log(slowest)) * settings.sample_time_s,
        simulated=True,
        tracking=None
        if len({limits.unit for limits in settings.axis_limits}) > 1
        else TrackingLimits(
            position_max=2 * settings.amplitude_max_m,
            speed_max=settings.velocity_max_m_s,
            acceleration_max=settings.acceleration_max_m_s2,
            correction_max=settings.amplitude_max_m / 2,
            correction_speed_max=settings.velocity_max_m_s / 2,
        ),
    )


class CoupledLoopsDriver:
    """Builds robots with coupled loops; each can run in a process of its own."""

    settings: type[CoupledLoopsSettings] = CoupledLoopsSettings
    """Settings of one robot in a fleet file."""
    shares_process = False
    """Whether the robots of a fleet have to run in one process."""
    environment: Mapping[str, str] = {}
    """Environment variables that the process of a robot needs."""

    def build(
        self, settings: Mapping[str, CoupledLoopsSettings], rng: np.random.Generator
    ) -> Mapping[str, CoupledLoops]:
        """Build the robots, disconnected, by name; each gets a noise stream of its own."""
        streams = rng.spawn(len(settings))
        return {
            name: CoupledLoops(name, own, stream)
            for (name, own), stream in zip(settings.items(), streams, strict=True)
        }


DRIVER = CoupledLoopsDriver()
