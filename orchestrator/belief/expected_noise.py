"""What noise is expected in a robot's next test, by what was found in those before it."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.multitone import foreseen_amplitude, shares_of
from nufleet.shared.robots.spec import AxisSpec

FLIGHT_TEST_STD = 0.02
"""Standard deviation that is expected of a test's estimates while the robot was never tested."""


class ExpectedNoise:
    """The noise of one axis, as tests of it showed it."""

    def __init__(self, axis: AxisSpec) -> None:
        """Begin without tests.

        Args:
            axis: The axis with its limits.
        """
        self._axis = axis
        self._loudest = 0.0
        self._found: list[FloatArray] = []

    @property
    def known(self) -> bool:
        """Whether a test has shown it."""
        return bool(self._found)

    def learn(self, omega_rad_s: FloatArray, variance: FloatArray, amplitude: float | None) -> None:
        """Learn from a test.

        Args:
            omega_rad_s: Frequencies of its tones in rad/s, shape (tones,).
            variance: Variances E|ẑ − z|² of its estimates, positive, shape (tones,).
            amplitude: Peak of its reference in the axis's unit; None if unknown.
        """
        foreseen = foreseen_amplitude(omega_rad_s, self._axis)
        peak = amplitude or foreseen
        self._loudest = max(self._loudest, peak / foreseen)
        self._found.append(np.stack([omega_rad_s, variance * (peak * shares_of(omega_rad_s)) ** 2]))

    def forget(self) -> None:
        """Forget all tests."""
        self._found, self._loudest = [], 0.0

    def amplitude(self, omega_rad_s: FloatArray) -> float:
        """Return the peak that the robot is expected to choose for tones, in the axis's unit.

        Args:
            omega_rad_s: Frequencies of the tones in rad/s, shape (tones,).
        """
        return (self._loudest or 1.0) * foreseen_amplitude(omega_rad_s, self._axis)

    def variance(
        self, omega_rad_s: FloatArray, times_as_long: float, amplitude: float | None = None
    ) -> FloatArray:
        """Return the variances that are expected of a test's estimates.

        They are inversely proportional to each tone's energy, that is to the square of its
        amplitude and to the measuring time. The fewer and the slower the tones, the larger their
        amplitudes.

        Args:
            omega_rad_s: Frequencies of the test's tones in rad/s, shape (tones,).
            times_as_long: Measuring time of the test, as a multiple of that of the first test.
            amplitude: Peak of the test; None for as much as the robot allows.

        Returns:
            Expected variances E|ẑ − z|², shape (tones,).
        """
        if not self._found:
            return np.full(len(omega_rad_s), FLIGHT_TEST_STD**2 / times_as_long)
        omega, energy = np.concatenate(self._found, axis=1)
        nearest = np.argmin(np.abs(omega - omega_rad_s[:, None]), axis=1)
        peak = amplitude or self.amplitude(omega_rad_s)
        return np.asarray(energy[nearest] / ((peak * shares_of(omega_rad_s)) ** 2 * times_as_long))
