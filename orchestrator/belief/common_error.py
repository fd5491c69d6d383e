"""An error that all estimates of a robot share, so that no number of tones averages it away.

What a nonlinear robot does in a motion of another form or size is not independent from tone to
tone: its response there is another smooth one. Taken for noise at each tone, it would vanish in the
fit of a loop to many tones.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray

KNOTS = 3
"""Number of independent values, evenly spaced over the band, between which the error is smooth."""


@dataclass(frozen=True, eq=False)
class CommonError:
    """The size of such an error at each frequency."""

    omega_rad_s: FloatArray
    """Frequencies in rad/s, rising, shape (frequencies,)."""
    variance: FloatArray
    """Variance E|error|² at each, shape (frequencies,)."""

    def draw(self, omega_rad_s: FloatArray, count: int, rng: np.random.Generator) -> ComplexArray:
        """Draw samples of the error.

        Args:
            omega_rad_s: Frequencies in rad/s, shape (frequencies,).
            count: Number of samples.
            rng: Generator that draws them.

        Returns:
            Samples, shape (count, frequencies).
        """
        # Beyond the tones that showed its size, the error stays what it is at the last of them.
        knots = np.linspace(self.omega_rad_s[0], self.omega_rad_s[-1], KNOTS)
        shape = np.stack([np.interp(omega_rad_s, knots, one) for one in np.eye(KNOTS)])
        shape /= np.linalg.norm(shape, axis=0)
        drawn = rng.standard_normal((2, count, KNOTS))
        size = np.sqrt(np.interp(omega_rad_s, self.omega_rad_s, self.variance) / 2)
        return np.asarray(((drawn[0] + 1j * drawn[1]) @ shape) * size)

    @staticmethod
    def of_tests(
        tests: Sequence[tuple[FloatArray, FloatArray]],
    ) -> CommonError | None:
        """Return what is left of the error where several tests are believed as far as the best.

        Args:
            tests: Frequencies in rad/s and variances of each test's error, each of shape (tones,).

        Returns:
            The error; None if some test has none, or there is no test.
        """
        if not tests:
            return None
        omega = np.unique(np.concatenate([each for each, _ in tests]))
        least = np.min([np.interp(omega, *_rising(*one)) for one in tests], axis=0)
        return CommonError(omega, least) if least.any() else None


def _rising(omega_rad_s: FloatArray, variance: FloatArray) -> tuple[FloatArray, FloatArray]:
    order = np.argsort(omega_rad_s)
    return omega_rad_s[order], variance[order]
