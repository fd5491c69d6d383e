"""The spectrum of a trajectory: how its motion is distributed over frequency."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError

BINS_MAX = 1000

NEGLIGIBLE = 1e-4
"""Share of the motion, as mean square speed, whose highest frequencies are joined into one."""


@dataclass(frozen=True)
class Spectrum:
    """The mean square of a trajectory at each frequency.

    The mean position is left out, because learning does not change how a constant is tracked.
    """

    omega_rad_s: FloatArray
    """Frequencies in rad/s, rising, shape (frequencies,)."""
    power: FloatArray
    """Mean square position at each frequency, in the square of its unit, shape (frequencies,)."""
    by_column: FloatArray | None = None
    """The parts of the power that belong to the trajectory's axes, shape (frequencies, axes); None
    where they are not told apart."""

    @staticmethod
    def flat(band_rad_s: tuple[float, float], points: int = 128) -> Spectrum:
        """Return equal power throughout a band (rad/s), for a trajectory that is not known yet."""
        return Spectrum(np.linspace(*band_rad_s, points), np.full(points, 1 / points))

    @property
    def shares(self) -> FloatArray:
        """Share of the total power at each frequency, shape (frequencies,); 0 of no motion."""
        return np.asarray(self.power / (self.power.sum() or 1.0))

    def outside(self, band_rad_s: tuple[float, float]) -> tuple[float, float]:
        """Return the shares of the mean square speed below and above a band (rad/s)."""
        motion = self.power * self.omega_rad_s**2
        total = float(motion.sum()) or 1.0
        low, high = band_rad_s
        below, above = self.omega_rad_s < low * (1 - 1e-9), self.omega_rad_s > high * (1 + 1e-9)
        return float(motion[below].sum()) / total, float(motion[above].sum()) / total


def spectra_of(plan: StudyPlan) -> dict[str, Spectrum]:
    """Return the spectrum of a plan's motion on each of its axes, at the same frequencies.

    A single axis stands for all of them. An axis on which the trajectory does not move has no
    power. There are none without a motion.
    """
    motion = plan.motion
    if motion is None:
        return {}
    omega, nothing = np.array(motion.omega_rad_s), (0.0,) * len(motion.omega_rad_s)
    if len(plan.axes) == 1:
        return {plan.axis: Spectrum(omega, np.array(motion.power))}
    return {
        axis: Spectrum(omega, np.array(motion.power_by_axis.get(axis, nothing)))
        for axis in plan.axes
    }


def joined(spectra: Mapping[str, Spectrum]) -> Spectrum:
    """Return the spectra of all axes one after the other, as one of all their motion."""
    each = list(spectra.values())
    return Spectrum(
        np.concatenate([one.omega_rad_s for one in each]),
        np.concatenate([one.power for one in each]),
    )


def spectrum_of(positions: FloatArray, sample_time_s: float) -> Spectrum:
    """Return the spectrum of a sampled trajectory.

    The transform treats the trajectory as periodic, and a jump from its end to its beginning would
    look like fast motion. Unless it is closed, its end no further from its beginning than samples
    are from each other, the line through both is therefore subtracted first. Of a long trajectory,
    neighbouring frequencies are joined, the more of them the higher they are: slow motions are the
    largest, and tell robots with low resonances apart.

    Args:
        positions: Positions, shape (samples,) or (samples, axes); the power of all axes is summed.
        sample_time_s: Time between samples in s.

    Returns:
        The spectrum, with about `BINS_MAX` frequencies at most.

    Raises:
        InvalidInputError: There are fewer than four samples, a number is not finite, or the
            trajectory does not move.
    """
    omega, amplitudes = _lines(positions, sample_time_s)
    # Parseval: bin k > 0 of the one-sided transform X carries the mean square 2 |X_k / samples|².
    each = 2 * np.abs(amplitudes) ** 2
    power = np.sum(each, axis=1)
    if not power.any():
        raise InvalidInputError("the trajectory does not move, or moves along a straight line only")
    motion = np.cumsum(power * omega**2)
    told_apart = int(np.searchsorted(motion, (1 - NEGLIGIBLE) * motion[-1])) + 1
    # Groups of bins, each at its power-weighted mean frequency.
    single = min(told_apart, BINS_MAX // 2)
    wider = np.geomspace(single, told_apart, min(told_apart - single, BINS_MAX - single) + 1)
    starts = np.concatenate([np.arange(single), np.unique(np.round(wider[:-1]).astype(int))])
    if told_apart < len(power):
        starts = np.append(starts, told_apart)
    joined_power = np.add.reduceat(power, starts)
    weight = np.maximum(joined_power, np.finfo(float).tiny)
    middle = np.add.reduceat(omega * power, starts) / weight
    empty = joined_power <= np.finfo(float).tiny
    parts = np.add.reduceat(each, starts, axis=0)
    return Spectrum(np.where(empty, omega[starts], middle), joined_power, parts)


def cross_power(positions: FloatArray, sample_time_s: float) -> tuple[FloatArray, ComplexArray]:
    """Return how the motions of a trajectory's axes go together, at every frequency.

    Args:
        positions: Positions, shape (samples, axes), prepared as for `spectrum_of`.
        sample_time_s: Time between samples in s.

    Returns:
        Frequencies in rad/s, shape (frequencies,), and 2 a_j a_k* of the axes' amplitudes a, whose
        diagonal adds up to the mean squares, shape (frequencies, axes, axes).

    Raises:
        InvalidInputError: There are fewer than four samples, or a number is not finite.
    """
    omega, amplitudes = _lines(positions, sample_time_s)
    return omega, np.asarray(2 * amplitudes[:, :, None] * amplitudes[:, None, :].conj())


def _lines(positions: FloatArray, sample_time_s: float) -> tuple[FloatArray, ComplexArray]:
    """Return the frequencies of a trajectory in rad/s, and its amplitudes (frequencies, axes)."""
    columns = positions[:, None] if positions.ndim == 1 else positions
    if columns.ndim != 2 or len(columns) < 4 or not np.all(np.isfinite(columns)):
        raise InvalidInputError(
            f"a trajectory needs at least four samples, all finite; its shape is {positions.shape}"
        )
    steps = np.linalg.norm(np.diff(columns, axis=0), axis=1)
    closed = float(np.linalg.norm(columns[0] - columns[-1])) <= float(steps.max())
    line = 0.0 if closed else np.linspace(columns[0], columns[-1], len(columns))
    amplitudes = np.fft.rfft(columns - line, axis=0)[1:] / len(columns)
    omega = 2 * np.pi * np.arange(1, len(amplitudes) + 1) / (len(columns) * sample_time_s)
    return np.asarray(omega, dtype=np.float64), np.asarray(amplitudes)
