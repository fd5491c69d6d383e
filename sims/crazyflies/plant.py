"""What flies behind the simulated firmware: a loop of known response, or another one."""

from __future__ import annotations

import cmath
import math
from typing import Protocol

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import NonNegative, Positive, Strict

GRAVITY_M_S2 = 9.81


class Plant(Protocol):
    """A drone with its position controller."""

    position_m: FloatArray
    """True position in m, shape (3,)."""
    velocity_m_s: FloatArray
    """True velocity in m/s, shape (3,)."""
    quaternion: FloatArray
    """True attitude x, y, z, w, shape (4,)."""

    def follow(self, reference_m: FloatArray, velocity_m_s: FloatArray, lasts_s: float) -> None:
        """Follow a constant reference, shape (3,), for `lasts_s` s."""


class LoopSettings(Strict):
    """A loop of second order on each axis, with a delay before it."""

    omega_rad_s: Positive = 6.0
    """Natural frequency."""
    damping_ratio: Positive = 0.7
    """Damping ratio, below 1."""
    gain: Positive = 1.0
    """Gain at rest on the horizontal axes."""
    delay_s: NonNegative = 0.0
    """Time from the arrival of a set-point until it acts."""

    def response(self, omega_rad_s: float, sample_time_s: float, delay_s: float = 0.0) -> complex:
        """Return the response at the samples to references that are held for one sample each.

        Args:
            omega_rad_s: Frequency.
            sample_time_s: Sample time T.
            delay_s: Delay of the references in addition to `self.delay_s`.
        """
        whole, part_s = divmod(self.delay_s + delay_s, sample_time_s)
        across = self._across(sample_time_s)
        late = self._across(sample_time_s - part_s) @ self._gained(part_s)
        shift = cmath.exp(-1j * omega_rad_s * sample_time_s)
        driven = self._gained(sample_time_s - part_s) + late * shift
        states = np.linalg.solve(np.eye(2) / shift - across, driven)
        return complex(self.gain * states[0] * shift**whole)

    def _across(self, lasts_s: float) -> FloatArray:
        """Return the state transition of position and velocity over some time."""
        omega, zeta = self.omega_rad_s, self.damping_ratio
        damped = omega * math.sqrt(1 - zeta**2)
        decay = math.exp(-zeta * omega * lasts_s)
        sine, cosine = math.sin(damped * lasts_s) / damped, math.cos(damped * lasts_s)
        fall = zeta * omega * sine
        return decay * np.array([[cosine + fall, sine], [-(omega**2) * sine, cosine - fall]])

    def _gained(self, lasts_s: float) -> FloatArray:
        """Return what a constant reference of 1 adds to position and velocity."""
        gained: FloatArray = np.array([1.0, 0.0]) - self._across(lasts_s)[:, 0]
        return gained


class KnownLoop:
    """A drone whose axes are independent loops; it follows positions and ignores velocities."""

    def __init__(self, settings: LoopSettings, start_m: tuple[float, float, float]) -> None:
        """Put it somewhere at rest.

        Args:
            settings: The loops; the gain acts around the start, and not on the height.
            start_m: Its position in m.
        """
        self._settings = settings
        self._gain = np.array([settings.gain, settings.gain, 1.0])
        self._centre_m = np.array(start_m)
        self.position_m = np.array(start_m)
        self.velocity_m_s = np.zeros(3)
        self.quaternion = np.array([0.0, 0.0, 0.0, 1.0])

    def follow(self, reference_m: FloatArray, velocity_m_s: FloatArray, lasts_s: float) -> None:
        """Follow a constant reference, shape (3,), for `lasts_s` s."""
        del velocity_m_s
        target_m = self._centre_m + self._gain * (reference_m - self._centre_m)
        off = np.stack([self.position_m - target_m, self.velocity_m_s])
        off = self._settings._across(lasts_s) @ off  # noqa: SLF001 - of its own settings
        self.position_m, self.velocity_m_s = target_m + off[0], off[1]


def fall(plant: Plant, lasts_s: float) -> None:
    """Let a drone fall without thrust, at most to the ground, where it lies still."""
    velocity = plant.velocity_m_s - np.array([0.0, 0.0, GRAVITY_M_S2 * lasts_s])
    position = plant.position_m + lasts_s * (plant.velocity_m_s + velocity) / 2
    if position[2] <= 0.0:
        position[2], velocity = 0.0, np.zeros(3)
    plant.position_m, plant.velocity_m_s = position, velocity


def drift(plant: Plant, lasts_s: float) -> None:
    """Let a drone that has levelled out fly on, at its height."""
    plant.velocity_m_s = plant.velocity_m_s * np.array([1.0, 1.0, 0.0])
    plant.position_m = plant.position_m + lasts_s * plant.velocity_m_s
