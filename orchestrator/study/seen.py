"""At which frequencies tests say what a robot does."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import BoolArray


@dataclass(frozen=True)
class Seen:
    """The frequencies at which tests say what a robot does on one axis."""

    bands_rad_s: FloatArray
    """Lower and upper ends of the bands in rad/s that hold them, shape (bands, 2)."""

    @staticmethod
    def above(lowest_rad_s: float) -> Seen:
        """Return that all is seen from a frequency in rad/s on."""
        return Seen(np.array([[lowest_rad_s, math.inf]]))

    @staticmethod
    def near(omega_rad_s: FloatArray, within_rad_s: float, lowest_rad_s: float = 0.0) -> Seen:
        """Return that only what lies near tones is seen.

        Args:
            omega_rad_s: Frequencies of the tones in rad/s, shape (tones,).
            within_rad_s: Largest distance from a tone in rad/s.
            lowest_rad_s: Frequency in rad/s below which nothing is seen.
        """
        ends_rad_s = np.stack([omega_rad_s - within_rad_s, omega_rad_s + within_rad_s], axis=1)
        return Seen(np.maximum(ends_rad_s, lowest_rad_s))

    def at(self, omega_rad_s: FloatArray) -> BoolArray:
        """Return which of some frequencies in rad/s are seen, shape (frequencies,)."""
        low, high = self.bands_rad_s.T
        inside = (omega_rad_s[:, None] >= low) & (omega_rad_s[:, None] <= high)
        return np.asarray(inside.any(axis=1))
