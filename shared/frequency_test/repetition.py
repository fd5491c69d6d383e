"""What does not repeat from one period of a test's tones to the next.

Once a robot has settled, its answer to tones repeats with their common period, whether it is linear
or not: all products of the tones do. What differs between two periods is noise, a drift or what
still rings. A record that is hardly longer than a period tells little by this, but distortion has
no part in it.
"""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.sinusoid_fit import exponentials

WHOLE = 0.05
"""Largest difference from a whole number of periods, as a share of one, that is due to samples."""


def period_samples(
    omega_rad_s: FloatArray, sample_time_s: float, samples: int, fewer: int
) -> int | None:
    """Return by which of a few numbers of samples all tones repeat; None if by none of them.

    Args:
        omega_rad_s: Frequencies of the tones in rad/s, shape (tones,).
        sample_time_s: Time between samples.
        samples: Largest number of samples.
        fewer: By how much it may be less.
    """
    counts = np.arange(samples - fewer, samples + 1)
    periods = np.outer(counts, omega_rad_s) * (sample_time_s / (2 * np.pi))
    off = np.abs(periods - np.round(periods)).max(axis=1)
    best = int(np.argmin(off))
    return int(counts[best]) if off[best] < WHOLE else None


def differences(
    output: FloatArray, steady: FloatArray, rates: FloatArray, period: int, block: int
) -> tuple[FloatArray, FloatArray]:
    """Return by how much an output differs from one period to the next, and what rings would.

    Args:
        output: Output of the robot, shape (samples,).
        steady: Columns of the tones and all else that is no transient, or one that is known, shape
            (samples, columns).
        rates: Decay rates σ of what may ring, and its frequencies ν, per block, shape (2, parts).
        period: Number of samples after which the tones repeat.
        block: Number of samples that are averaged.

    Returns:
        Mean differences of blocks, shape (blocks,), and those of cosines and sines of all parts,
        shape (blocks, 2, parts), both without a common offset, which a drift leaves. There are no
        blocks in a record that is hardly longer than a period.
    """
    blocks = max(0, len(output) - period) // block
    # Samples do not hold a whole number of periods, so that the tones leave a little.
    left = output - steady @ np.linalg.lstsq(steady, output, rcond=None)[0]
    compared = slice(blocks * block)
    found = (left[period:][compared] - left[compared]).reshape(blocks, block).mean(axis=1)
    decay, omega = rates
    parts = exponentials(omega, blocks, decay=decay)
    parts = parts * (np.exp((1j * omega - decay) * (period / block)) - 1)
    both = np.stack([parts.real, parts.imag], axis=1)
    few = max(1, blocks)
    return found - found.sum() / few, both - both.sum(axis=0) / few
