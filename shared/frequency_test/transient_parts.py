"""What a record of tones may hold besides them: what rings, and distortion between the tones.

Each is a sum of Chebyshev polynomials on the record, so that what the tones leave of all of them
follows from what they leave of a hundred polynomials.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander

from nufleet.shared.arrays import FloatArray

DEGREE = 100
"""Degree of polynomials of which all parts are sums, to rounding errors: a part turns by at most
e^{jz} around the middle of the record with |z| of 60, from which degree on the coefficients, Bessel
functions of z, vanish (Trefethen, Approximation Theory and Approximation Practice, 2013)."""

DECAYS = 13
SLOWEST = 0.25
FASTEST = 60.0
"""Number of decay rates, and the least and the largest of them, per length of the record."""

HALF_PERIODS = 30
"""Largest number of half periods in the record. What rings faster than that is told from tones."""

FINE = 0.5
"""Distance of frequencies, in half periods per length of the record; or else in decay rates."""

DAMPED = 0.05
"""Damping ratio σ/ν below which a part is improbable."""

LINES_FROM = 3.0
LINES_TO = 120.0
LINES_APART = 0.1
SAME = 1e-6
"""Least and largest frequency of distortion, the steps to which its frequencies are rounded, and
those to which the products of two tones are, as multiples of 1 over the length of the record."""


@dataclass(frozen=True, eq=False)
class Parts:
    """Oscillations e^{(−σ + jν)t} in a record of length 1."""

    decay: FloatArray
    omega: FloatArray
    """σ and ν of each part, as multiples of 1 over the length of the record, shape (parts,)."""
    probability: FloatArray
    """Prior probability of each, shape (parts,); in all 1."""
    both: FloatArray
    """Chebyshev coefficients of the real parts of all, and then of their imaginary parts, shape
    (DEGREE + 1, 2 parts)."""

    @staticmethod
    def of(decay: FloatArray, omega: FloatArray, density: FloatArray) -> Parts:
        """Return parts with a probability proportional to a density, shape (parts,)."""
        nodes = chebpts1(DEGREE + 1)
        turning = np.exp(np.outer((nodes + 1) / 2, 1j * omega - decay))
        both = np.hstack([turning.real, turning.imag])
        both = 2 / len(nodes) * chebvander(nodes, DEGREE).T @ both
        both[0] /= 2
        return Parts(decay, omega, density / density.sum(), both)


def ringing_parts(top: float) -> Parts:
    """Return what may ring below a frequency, and what hardly oscillates.

    Args:
        top: The frequency, as a multiple of 1 over the length of the record.
    """
    every = _all_parts()
    kept = every.omega < np.maximum(top, every.decay)
    density = every.probability * kept
    for decay in np.unique(every.decay):
        of_decay = every.decay == decay
        density[of_decay] /= density[of_decay].sum()
    return Parts(
        every.decay[kept],
        every.omega[kept],
        density[kept] / density.sum(),
        every.both[:, np.tile(kept, 2)],
    )


@lru_cache(1)
def _all_parts() -> Parts:
    """Return all parts; they are the same in a record of any length."""
    decays, omegas, densities = [], [], []
    for decay in np.geomspace(SLOWEST, FASTEST, DECAYS):
        omega = np.arange(0.0, HALF_PERIODS * np.pi, FINE * max(decay, np.pi)) + 0.1 * decay
        decays.append(np.full(len(omega), decay))
        omegas.append(omega)
        # Hardly damped parts, σ below `DAMPED` ν, are the less probable the less they are.
        densities.append(np.minimum(1.0, decay / (DAMPED * omega)))
    return Parts.of(np.concatenate(decays), np.concatenate(omegas), np.concatenate(densities))


def distortion(tones: FloatArray) -> tuple[Parts, Parts]:
    """Return what distortion may add between the tones: products of two, and of three, of them.

    Args:
        tones: Frequencies of the tones, as multiples of 1 over the length of the record.
    """
    both = np.concatenate([tones, -tones])
    two = _apart((tones[:, None] + both).ravel(), SAME)
    return _lines(two, tones), _lines((two[:, None] + both).ravel(), tones)


def _lines(products: FloatArray, tones: FloatArray) -> Parts:
    omega = _apart(products[np.abs(products) < LINES_TO], LINES_APART)
    from_tone = np.abs(omega[:, None] - tones).min(axis=1)
    omega = omega[(omega > LINES_FROM) & (from_tone > 2 * LINES_APART)]
    return Parts.of(np.zeros(len(omega)), omega, np.ones(len(omega)))


def _apart(omega: FloatArray, step: float) -> FloatArray:
    """Return frequencies without their signs, in multiples of a step, rising, each of them once."""
    return np.asarray(np.unique(np.round(np.abs(omega) / step)) * step)
