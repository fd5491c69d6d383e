"""A simulated quadrotor as a Robot: two horizontal axes, and height and heading if asked for."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.sims.measurement_noise import MeasurementNoise
from nufleet.sims.quadrotors.controllers import HOVER_HEIGHT_M
from nufleet.sims.quadrotors.flight import Flight, Plant, Track
from nufleet.sims.quadrotors.settings import SAMPLE_TIME_S, QuadrotorSettings
from nufleet.sims.simulated_robot import RestRule, SimulatedRobot

STATE_NAMES = ("position", "velocity", "tilt")

HEIGHT_ERROR_MAX_M = 0.5
"""Half the hovering height; a vehicle further off than this has lost control of its height."""

COS_TILT_MIN = 0.36
"""Cosine of the largest tilt, 69 degrees, at which only 36 % of the thrust carry the vehicle."""

HOVER_SETTLE_S = 20.0
"""Time to hover after the start. The firmware's height integrator fills within 7 s; after that the
vehicle hovers where it will stay."""

RATE_PER_ANGLE_1_S = 5.0
"""Noise of the heading's rate per noise of the heading, as of velocity per position."""

REST = RestRule(speed=0.5, position_max=0.02, velocity_max=0.02, patience_s=30.0)


class Quadrotor(SimulatedRobot):
    """A vehicle with its baseline controller: horizontal references in, measured position out."""

    def __init__(
        self,
        name: str,
        settings: QuadrotorSettings,
        flight: Flight,
        plant: Plant,
        rng: np.random.Generator,
    ) -> None:
        noise = settings.noise
        sigma = np.tile([noise.position_m, noise.velocity_m_s, noise.tilt_rad], (settings.axes, 1))
        if settings.axes == 4:
            sigma[2, 2] = 0.0  # neither has a tilt
            sigma[3] = noise.tilt_rad, RATE_PER_ANGLE_1_S * noise.tilt_rad, 0.0
        super().__init__(name, _spec(settings), STATE_NAMES, MeasurementNoise(sigma, rng), REST)
        self._flight = flight
        self._fresh_plant = plant
        self._plant = plant
        # The delay is `late` whole samples, and a share of one more.
        late, self._share_late = divmod(settings.delay_s / SAMPLE_TIME_S, 1.0)
        self._on_the_way = np.zeros((int(late) + 1, settings.axes))
        self._hovers_at_m = 0.0

    @property
    def flown_by(self) -> tuple[Flight, Plant]:
        """The program that flies it, and the vehicle as it is now."""
        return self._flight, self._plant

    def _start(self) -> FloatArray:
        self._plant = self._fresh_plant
        self._on_the_way = np.zeros_like(self._on_the_way)
        self._hovers_at_m = 0.0
        hover = np.zeros((round(HOVER_SETTLE_S / SAMPLE_TIME_S), len(self.spec.axes)))
        state = np.array(self._play(hover)[-1])
        if len(state) == 4:
            # The firmware believes in another mass, and hovers lower than it was told to.
            self._hovers_at_m, state[2, 0] = float(state[2, 0]), 0.0
        return state

    def _play(self, references: FloatArray) -> FloatArray:
        sent = np.concatenate([self._on_the_way, references])
        self._on_the_way = sent[len(references) :]
        earlier, later = sent[: len(references)], sent[1 : len(references) + 1]
        arriving = later + self._share_late * (earlier - later)
        self._plant, track = self._flight.fly(self._plant, arriving)
        self._raise_if_crashed(track)
        if self._hovers_at_m:
            track.states[:, 2, 0] -= self._hovers_at_m
        return track.states

    def _raise_if_crashed(self, track: Track) -> None:
        # A height or tilt that is not finite counts as a crash, too: comparing NaN gives False.
        well = (
            np.isfinite(track.states).all(axis=(1, 2))
            & (np.abs(track.height_m - HOVER_HEIGHT_M) < HEIGHT_ERROR_MAX_M)
            & (track.cos_tilt > COS_TILT_MIN)
        )
        if not well.all():
            k = int(np.argmin(well))
            raise RobotError(
                f"{self._name} crashed {k * SAMPLE_TIME_S:.2f} s into its motion: height "
                f"{track.height_m[k]:.2f} m instead of {HOVER_HEIGHT_M:g} m, cosine of the tilt "
                f"{track.cos_tilt[k]:.2f}; drive it more gently"
            )


def _spec(settings: QuadrotorSettings) -> RobotSpec:
    limits = settings.limits
    axes = tuple(
        AxisSpec(
            name=name,
            unit="m",
            amplitude_max=limits.amplitude_m,
            velocity_max=limits.velocity_m_s,
            acceleration_max=limits.acceleration_m_s2,
        )
        for name in ("x", "y")
    )
    more = settings.height_and_heading
    if more is not None:
        axes += (
            AxisSpec(
                name="z",
                unit="m",
                amplitude_max=more.height_amplitude_m,
                velocity_max=more.height_velocity_m_s,
                acceleration_max=more.height_acceleration_m_s2,
            ),
            AxisSpec(
                name="yaw",
                unit="rad",
                amplitude_max=more.heading_amplitude_rad,
                velocity_max=more.heading_velocity_rad_s,
                acceleration_max=more.heading_acceleration_rad_s2,
            ),
        )
    return RobotSpec(
        kind="quadrotor",
        axes=axes,
        sample_time_s=SAMPLE_TIME_S,
        omega_min_rad_s=settings.omega_min_rad_s,
        omega_max_rad_s=settings.omega_max_rad_s,
        duration_max_s=settings.flight_time_max_s,
        settling_time_s=settings.settling_time_s,
        simulated=True,
        tracking=settings.tracking if more is None else None,
    )
