"""How a trajectory's motion is distributed over frequency."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.study.interface import DesiredMotion
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError

BINS_MAX = 1000

NEGLIGIBLE = 1e-4
"""The fastest part of the motion, up to this share of it, counts as one frequency."""


@dataclass(frozen=True)
class Spectrum:
    """Mean square of a trajectory at each frequency, both of shape (frequencies,), ω rising.

    The mean position is left out: a constant is tracked or not whatever is learned.
    """

    omega_rad_s: FloatArray
    power: FloatArray

    @staticmethod
    def flat(band_rad_s: tuple[float, float], points: int = 128) -> Spectrum:
        """Return equal power everywhere in a band, for trajectories that are not known yet."""
        return Spectrum(np.linspace(*band_rad_s, points), np.full(points, 1 / points))

    @staticmethod
    def of_motion(motion: DesiredMotion) -> Spectrum:
        """Return the spectrum that a study's plan holds."""
        return Spectrum(np.array(motion.omega_rad_s), np.array(motion.power))

    @property
    def shares(self) -> FloatArray:
        """The power at each frequency as its share of all, shape (frequencies,)."""
        return np.asarray(self.power / self.power.sum())

    def outside(self, band_rad_s: tuple[float, float]) -> tuple[float, float]:
        """Return the shares of the motion, as mean square speed, below and above a band."""
        motion = self.power * self.omega_rad_s**2
        total = float(motion.sum()) or 1.0
        low, high = band_rad_s
        below, above = self.omega_rad_s < low * (1 - 1e-9), self.omega_rad_s > high * (1 + 1e-9)
        return float(motion[below].sum()) / total, float(motion[above].sum()) / total


def spectrum_of(positions: FloatArray, sample_time_s: float) -> Spectrum:
    """Return the spectrum of a sampled trajectory.

    A line through both ends is taken off first, since the transform repeats the trajectory for ever
    and a jump between its ends would look like fast motion. Of a long trajectory neighbouring
    frequencies are joined.

    Args:
        positions: shape (samples,) or (samples, axes); axes are added up.
        sample_time_s: time between samples.

    Raises:
        InvalidInputError: fewer than four samples, a number that is not finite, or no motion.
    """
    columns = positions[:, None] if positions.ndim == 1 else positions
    if columns.ndim != 2 or len(columns) < 4 or not np.all(np.isfinite(columns)):
        raise InvalidInputError(
            f"a trajectory needs at least four samples, all finite; its shape is {positions.shape}"
        )
    line = np.linspace(columns[0], columns[-1], len(columns))
    amplitudes = np.fft.rfft(columns - line, axis=0)[1:] / len(columns)
    power = 2 * np.sum(np.abs(amplitudes) ** 2, axis=1)
    if not power.any():
        raise InvalidInputError("the trajectory does not move, or moves along a straight line only")
    omega = 2 * np.pi * np.arange(1, len(power) + 1) / (len(columns) * sample_time_s)
    motion = np.cumsum(power * omega**2)
    told_apart = int(np.searchsorted(motion, (1 - NEGLIGIBLE) * motion[-1])) + 1
    starts = np.arange(0, told_apart, -(-told_apart // BINS_MAX))
    if told_apart < len(power):
        starts = np.append(starts, told_apart)
    joined = np.add.reduceat(power, starts)
    middle = np.add.reduceat(omega * power, starts) / np.maximum(joined, np.finfo(float).tiny)
    empty = joined <= np.finfo(float).tiny
    return Spectrum(np.where(empty, omega[starts], middle), joined)
