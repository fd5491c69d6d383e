"""Where a robot shall be at each moment: set-points from references, and the ways between them."""

from __future__ import annotations

import math

import numpy as np

from nufleet.robot_agent.drivers.ros2.messages import SetPoint
from nufleet.robot_agent.drivers.ros2.settings import TWISTS, Ros2Settings
from nufleet.shared.arrays import FloatArray

SPEED_SHARE = 0.5
"""Share of an axis's limits that the way to rest, or to the origin, needs at most."""

HELD_SPEED = 0.25
HELD_ACCELERATION = 0.5
"""Limits on the way of a component that is no axis, in m or rad and s; the speed also limits what a
Twist corrects."""


class Places:
    """The places of one robot's commanded components or joints, in the order of the settings."""

    def __init__(self, settings: Ros2Settings) -> None:
        self._settings = settings
        self._names = settings.commanded
        self._axes = len(settings.axes)
        self._yaw = (
            [i for i, name in enumerate(self._names) if name == "yaw"]
            if not settings.joints
            else []
        )
        held = len(self._names) - self._axes
        self._speed_max = np.array(
            [axis.velocity_max for axis in settings.axes] + held * [HELD_SPEED]
        )
        self._rest = np.zeros(len(self._names))
        self._rest[: self._axes] = [axis.origin for axis in settings.axes]

    def begin(self, here: FloatArray) -> None:
        """Rest at the origin from now on; what is neither an axis nor held stays here.

        Args:
            here: Measured place, shape (components,).
        """
        hold = self._settings.hold
        for i, name in enumerate(self._names[self._axes :], self._axes):
            self._rest[i] = hold.get(name, here[i])

    @property
    def rest(self) -> FloatArray:
        """The place at reference 0, shape (components,)."""
        return self._rest.copy()

    def at(self, reference: FloatArray) -> FloatArray:
        """Return the place for a reference, shape (axes,); shape (components,)."""
        place = self._rest.copy()
        place[: self._axes] += reference
        return place

    def output(self, here: FloatArray) -> FloatArray:
        """Return outputs, shape (…, axes), of measured places, shape (…, components or more)."""
        return self.away(here[..., : len(self._names)])[..., : self._axes]

    def away(self, here: FloatArray) -> FloatArray:
        """Return how far measured places, shape (…, components), are from rest."""
        return self._turned(here - self._rest)

    def way(self, start: FloatArray, stop: FloatArray) -> FloatArray:
        """Return a smooth way between two places, shape (samples, components).

        It is a raised cosine that ends at `stop`, and starts one sample after `start`.
        """
        distance = self._turned(stop - start)
        axes = self._settings.axes
        held = len(self._names) - self._axes
        speed = SPEED_SHARE * np.array([axis.velocity_max for axis in axes])
        hard = SPEED_SHARE * np.array([axis.acceleration_max for axis in axes])
        speed = np.concatenate([speed, np.full(held, HELD_SPEED)])
        hard = np.concatenate([hard, np.full(held, HELD_ACCELERATION)])
        # D (1 − cos(π t / T)) / 2 reaches the speed π D / (2 T), and accelerates by π² D / (2 T²).
        lasts_s = max(
            float(np.max(math.pi / 2 * np.abs(distance) / speed)),
            float(np.max(math.pi * np.sqrt(np.abs(distance) / (2 * hard)))),
        )
        samples = math.ceil(lasts_s / self._settings.sample_time_s)
        share = (1 - np.cos(math.pi * np.arange(1, samples + 1) / max(1, samples))) / 2
        return stop - np.outer(1 - share, distance)

    def set_point(self, place: FloatArray, before: FloatArray, here: FloatArray | None) -> SetPoint:
        """Return the set-point of a place.

        Args:
            place: The place, shape (components,).
            before: The place one sample earlier.
            here: The measured place, shape (components or more,); None if it is not known, at
                which a Twist stands still.
        """
        velocity = (place - before) / self._settings.sample_time_s
        gain = self._settings.command.gain_1_s
        if self._settings.command.type not in TWISTS or gain is None:
            return SetPoint(self._by_name(place), self._by_name(velocity))
        if here is None:
            return SetPoint({"yaw": 0.0}, {})
        correction = gain * self._turned(place - here[: len(place)])
        # A measurement that jumps, or comes back after a gap, must not command any speed.
        velocity = velocity + np.clip(correction, -self._speed_max, self._speed_max)
        yaw = float(here[self._settings.measured.index("yaw")])
        return SetPoint({"yaw": yaw}, self._by_name(velocity))

    def speed_share(self, point: SetPoint) -> float:
        """Return the velocity of a set-point as a share of the largest one of its component."""
        velocity = np.array([point.velocities.get(name, 0.0) for name in self._names])
        return float(np.max(np.abs(velocity) / self._speed_max))

    def _by_name(self, values: FloatArray) -> dict[str, float]:
        return dict(zip(self._names, values.tolist(), strict=True))

    def _turned(self, difference: FloatArray) -> FloatArray:
        """Return differences of places, with turns of less than half a circle."""
        turned = np.array(difference, dtype=np.float64)
        turned[..., self._yaw] = np.remainder(turned[..., self._yaw] + np.pi, 2 * np.pi) - np.pi
        return turned
