"""crazyflow's Crazyflie, with its Mellinger controller, behind the simulated firmware."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.sims.crazyflies.plant import KnownLoop, LoopSettings
from nufleet.sims.quadrotors.flight import Flight, Plant
from nufleet.sims.quadrotors.settings import SAMPLE_TIME_S


class QuadrotorPlant:
    """A vehicle that crazyflow flies in the horizontal plane, sample by sample.

    A set-point acts from the next sample of the simulation on, and the position between two samples
    lies on a straight line. crazyflow holds a height of its own; a loop of second order takes its
    place here.
    """

    def __init__(self, flight: Flight, plant: Plant) -> None:
        """Put a vehicle on the ground at the origin.

        Args:
            flight: The compiled program of the vehicle's kind.
            plant: Vehicle to fly.
        """
        self._flight, self._plant = flight, plant
        self._height = KnownLoop(LoopSettings(), (0.0, 0.0, 0.0))
        self._before = self._after = np.zeros((2, 2))  # position and velocity of each axis
        self._since_s = 0.0
        self.quaternion = np.array([0.0, 0.0, 0.0, 1.0])

    @property
    def position_m(self) -> FloatArray:
        """True position in m, shape (3,)."""
        share = self._since_s / SAMPLE_TIME_S
        horizontal = (1 - share) * self._before[:, 0] + share * self._after[:, 0]
        return np.array([*horizontal, self._height.position_m[2]])

    @position_m.setter
    def position_m(self, position_m: FloatArray) -> None:
        self._height.position_m = position_m.copy()  # as it falls, it moves down

    @property
    def velocity_m_s(self) -> FloatArray:
        """True velocity in m/s, shape (3,)."""
        return np.array([*self._after[:, 1], self._height.velocity_m_s[2]])

    @velocity_m_s.setter
    def velocity_m_s(self, velocity_m_s: FloatArray) -> None:
        self._height.velocity_m_s = velocity_m_s.copy()

    def follow(self, reference_m: FloatArray, velocity_m_s: FloatArray, lasts_s: float) -> None:
        """Follow a constant reference, shape (3,), for `lasts_s` s.

        crazyflow derives its velocity itself.
        """
        self._height.follow(reference_m, velocity_m_s, lasts_s)
        self._since_s += lasts_s
        while self._since_s >= SAMPLE_TIME_S:
            self._since_s -= SAMPLE_TIME_S
            self._plant, track = self._flight.fly(self._plant, reference_m[np.newaxis, :2])
            self._before, self._after = self._after, track.states[-1, :, :2]
