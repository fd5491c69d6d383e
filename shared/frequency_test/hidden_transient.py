"""The transient that the tones of a test may hide.

A part of the transient that decays within the record stands out of it, and `ring_down` finds it.
One that outlasts the record, at a frequency near a tone or below all of them, looks like that tone,
or like an offset and a drift: many decay rates σ and frequencies ν explain the record equally well,
and each of them says something else about the tones. So none is chosen here. All are averaged,
weighted by how well they explain the record (Bayesian model averaging: Hoeting et al., Statistical
Science 14, 1999), and the tones are less certain by what they would do to them.

What a robot that is not linear adds at sums and differences of its tones does not decay. It
explains a record as well as a slow transient does, and is no reason to wait.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import TypeVar

import numpy as np
from numpy.polynomial.chebyshev import chebpts1, chebvander
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.frequency_test.ring_down import (
    HIGHER,
    PHASE_PER_BLOCK,
    SAMPLES_MAX,
    ringing,
)
from nufleet.shared.frequency_test.sinusoid_fit import exponentials

T = TypeVar("T", np.float64, np.complex128)

CERTAIN = 0.9
"""Probability of a transient from which it is a finding."""

EXPECTED = 0.5
"""Prior probability that something still rings."""

SIZE = 0.3
"""Prior standard deviation of what rings at the beginning, as a multiple of the deviation of
the output."""

DECAYS = 10
SLOWEST = 0.25
FASTEST = 20.0
"""Number of decay rates, and the least and the largest of them, per length of the record."""

HALF_PERIODS = 30
"""Largest number of half periods in the record. What rings faster than that is told from tones."""

LINES_FROM = 3.0
LINES_APART = 0.1
SAME = 1e-6
"""Least frequency of what does not decay, the steps to which such frequencies are rounded, and
those to which the products of two tones are, as multiples of 1 over the length of the record."""

DEGREE = 80
"""Degree of polynomials of which every part is a sum, to rounding errors: a part turns by at most
e^{jz} around the middle of the record with |z| of 48, from which degree on the coefficients, Bessel
functions of z, vanish (Trefethen, Approximation Theory and Approximation Practice, 2013)."""

FINE = 0.5
"""Distance of frequencies, in half periods per length of the record; or else in decay rates."""

DAMPED = 0.05
"""Damping ratio σ/ν below which a part is improbable."""

EXPLAINED = 6
"""Largest number of parts that are taken away until the rest is white noise."""

DEPENDENT = 1e-10
"""Share of an energy below which columns are not told apart."""

WHITE = 3.0
NEIGHBOURS = 17
"""Power of the rest over that of white noise, averaged over as many neighbouring frequencies, from
which it is no decay that the tones leave, but gusts, a drift or a change."""

TINY = 1e-12
"""Share of a part's energy, as its samples are at most 1, below which the tones leave nothing."""

PHASE_MAX = 1.2
FOLDED = 3.0
"""Phases in rad per block: the largest of the fastest tone, and that from which harmonics are left
out."""

NEGLIGIBLE = 1e-4
"""Least noise, as a multiple of the deviation of the output."""

RECORDS_KEPT = 16
ALIKE = 4
"""Number of records of which all that does not depend on the output is kept for further robots, and
the number of blocks up to which the beginning of a record is left out, so that robots which settle
nearly equally long have the same."""


@dataclass(frozen=True)
class HiddenTransient:
    """What is believed of the transient that the tones of a test may hide."""

    probability: float
    """Probability that there is one."""
    decay_1_s: float
    """Decay rate σ that it exceeds as probably as not, if there is one; infinite if that is the
    largest of those that are tried, as it may be any that is larger."""
    omega_rad_s: float
    """Its most probable frequency ν."""
    variance: FloatArray
    """Mean square by which it moves each tone's phasor, shape (tones,), in the output's unit."""


def may_ring(hidden: HiddenTransient | None, settle_s: float) -> Finding | None:
    """Return the finding that a robot settles more slowly than the test waited; None if it did.

    Args:
        hidden: What the tones may hide of it; None if nothing is known of that.
        settle_s: Time that the test waited, after the ramp.
    """
    if hidden is None or hidden.probability < CERTAIN:
        return None
    return ringing(hidden.decay_1_s, hidden.omega_rad_s, settle_s)


def hidden_transient(
    output: FloatArray,
    omega_rad_s: FloatArray,
    tones: int,
    sample_time_s: float,
    settle_samples: int,
    found: FloatArray | None = None,
) -> HiddenTransient | None:
    """Return what the tones may hide; None if that cannot be told in a record like this.

    Args:
        output: Output while the reference consists of tones alone, that is while the robot settles
            and is measured, shape (samples,), in any unit.
        omega_rad_s: Frequencies of the tones and, after them, of their harmonics, shape (F,).
        tones: Number of tones.
        sample_time_s: Time between samples.
        settle_samples: Number of samples before those that the tones are fitted to.
        found: Transient that was found already, shape (samples, columns); None if none was.
    """
    top_rad_s = float(omega_rad_s[:tones].max())
    block = max(1, int(PHASE_PER_BLOCK / (top_rad_s * sample_time_s)))
    block = max(block, math.ceil(len(output) / SAMPLES_MAX))
    if top_rad_s * block * sample_time_s > PHASE_MAX:
        return None
    # In longer blocks, the highest harmonics would pass for other frequencies.
    omega_rad_s = omega_rad_s[omega_rad_s * block * sample_time_s < FOLDED]
    left_out = settle_samples // block % ALIKE * block
    output, settle_samples = output[left_out:], settle_samples - left_out
    count = len(output) // block
    if count < 4 * len(omega_rad_s) + 8:
        return None
    y = _averaged(output, block)
    size = float(np.std(y))
    # White noise, from what neighbouring samples differ by.
    white = float(np.mean(np.diff(output, 2) ** 2)) / (6 * block)
    white = max(white, (NEGLIGIBLE * size) ** 2)
    if white == 0.0:
        return None
    first = settle_samples // block
    of = (tuple(omega_rad_s.tolist()), tones, block * sample_time_s, count, first)
    grid = _kept_grid(*of) if found is None else _Grid.of(*of, _averaged(found[left_out:], block))
    left = y - grid.basis @ (grid.basis.T @ y)
    heard = grid.smooth.T @ left
    noise = grid.noise(heard, float(left @ left), white)
    if noise is None:
        return None
    prior = (SIZE * size) ** 2
    # Along each direction, whitened: the data b = g a + noise, with a of variance `prior`.
    along = (heard @ grid.directions).reshape(2, -1)
    signal = prior * grid.power
    gain = signal + noise
    log_weight = 0.5 * (along**2 * signal / (gain * noise) - np.log(gain / noise)).sum(axis=0)
    log_weight += grid.log_prior + math.log(EXPECTED)
    largest = max(float(log_weight.max()), math.log(1 - EXPECTED))
    weight, none = np.exp(log_weight - largest), (1 - EXPECTED) * math.exp(-largest)
    weight /= weight.sum() + none
    decaying = np.where(grid.decay_1_s > 0, weight, 0.0)
    decay_1_s = _median(grid.decay_1_s, decaying)
    # Mean and variance of each part's amplitudes, and what they do to the tones.
    mean, spread = np.sqrt(grid.power) * along * (prior / gain), prior * noise / gain
    moved = np.abs((grid.moved * mean).sum(axis=1)) ** 2
    moved += (np.abs(grid.moved) ** 2 * spread).sum(axis=1)
    return HiddenTransient(
        float(decaying.sum()),
        decay_1_s if decay_1_s < grid.decay_1_s.max() else math.inf,
        float(grid.omega_rad_s[np.argmax(decaying)]),
        moved @ weight,
    )


@dataclass(frozen=True, eq=False)
class _Grid:
    """All parts that a transient may have; nothing in it depends on the output."""

    basis: FloatArray
    """Orthonormal columns of tones, offset and drift, shape (count, columns)."""
    smooth: FloatArray
    """Polynomials that every part is a sum of, shape (count, DEGREE + 1)."""
    gram: FloatArray
    """Products of what the tones leave of them, shape (DEGREE + 1, DEGREE + 1)."""
    decay_1_s: FloatArray
    omega_rad_s: FloatArray
    """Decay rate σ and frequency ν of each part, shape (parts,)."""
    log_prior: FloatArray
    """Logarithm of the prior probability of each, shape (parts,)."""
    directions: FloatArray
    """What the tones leave of each part: two orthonormal sums of what they leave of `smooth`,
    first of all parts one of them and then the other, shape (DEGREE + 1, 2 parts)."""
    power: FloatArray
    """Squared length of what is left along each, shape (2, parts)."""
    moved: ComplexArray
    """By how much each of the two, if it is mistaken for tones, moves their phasors, shape (tones,
    2, parts)."""

    @staticmethod
    def of(
        omega_rad_s: tuple[float, ...],
        tones: int,
        step_s: float,
        count: int,
        first: int,
        found: FloatArray | None = None,
    ) -> _Grid:
        length_s, frequencies = step_s * (count - 1), len(omega_rad_s)
        turning = exponentials(step_s * np.array(omega_rad_s), count)
        drift = np.linspace(-1, 1, count)
        columns = [turning.real, turning.imag, np.ones((count, 1)), drift[:, None]]
        if found is not None:
            columns.append(found)
        steady = np.concatenate(columns, axis=1)
        basis = np.linalg.qr(steady)[0]
        top = length_s * HIGHER * max(omega_rad_s[:tones])
        parts = _parts().below(top).and_also(_lines(length_s * np.array(omega_rad_s[:tones]), top))
        smooth = np.asarray(chebvander(drift, DEGREE), dtype=np.float64)
        taken = basis.T @ smooth
        gram = smooth.T @ smooth - taken.T @ taken
        # The tones are fitted to the measuring part alone.
        late, triangle = np.linalg.qr(steady[first:])
        theta = np.linalg.solve(triangle, late.T @ smooth[first:])
        phasors = (theta[:tones] - 1j * theta[frequencies : frequencies + tones]) @ parts.both
        lengths, along = _axes(parts.both, gram @ parts.both)
        power = np.maximum(lengths, TINY * count)
        return _Grid(
            basis,
            smooth,
            gram,
            parts.decay / length_s,
            parts.omega / length_s,
            parts.log_prior,
            (_turned(parts.both, along) / np.sqrt(power)).reshape(DEGREE + 1, -1),
            power,
            _turned(phasors, along),
        )

    def noise(self, heard: FloatArray, energy: float, white: float) -> float | None:
        """Return the variance of the noise in what the tones leave; None if it is not white.

        Args:
            heard: Products of what they leave and `smooth`, shape (DEGREE + 1,).
            energy: Sum of the squares of what they leave.
            white: Variance of white noise, from neighbouring samples.
        """
        slowest = int(np.sum(self.decay_1_s == self.decay_1_s[0]))
        around = min(NEIGHBOURS, slowest)
        degrees = len(self.basis) - self.basis.shape[1]
        energies = self._energies(heard)
        for _ in range(EXPLAINED):
            near = self._near(int(np.argmax(energies)))
            through = self.gram @ near
            weights = np.linalg.lstsq(near.T @ through, near.T @ heard, rcond=DEPENDENT)[0]
            energy -= float(heard @ near @ weights)
            heard = heard - through @ weights
            degrees -= near.shape[1]
            energies = self._energies(heard)
            level = uniform_filter1d(energies[:slowest] / 2, around, mode="nearest")
            if level.max() <= WHITE * white:
                return float(max(white, energy / degrees))
        return None

    def _near(self, part: int) -> FloatArray:
        """Return a part and its derivative with respect to σ and ν, shape (DEGREE + 1, 4).

        They are nearly all that a transient between the parts of the grid consists of.
        """
        own = self.directions[:, [part, len(self.decay_1_s) + part]]
        # x T_n = (T_{n − 1} + T_{n + 1})/2, and x T_0 = T_1.
        late = np.zeros_like(own)
        late[:-1] = own[1:] / 2
        late[1:] += own[:-1] / 2
        late[1] += own[0] / 2
        return np.hstack([own, late])

    def _energies(self, heard: FloatArray) -> FloatArray:
        """Return the energy that each part explains, shape (parts,)."""
        both = ((heard @ self.directions) ** 2).reshape(2, -1)
        return np.asarray(both[0] + both[1])


def _axes(both: FloatArray, through: FloatArray) -> tuple[FloatArray, ComplexArray]:
    """Return squared lengths and direction of the axes of the ellipse of a cosine and a sine.

    Args:
        both: Cosines and sines, in any coordinates, shape (coordinates, 2 parts).
        through: The metric of these coordinates times them, in the same shape.

    Returns:
        Squared length of the longer and the shorter axis, shape (2, parts), and the direction of
        the longer one, as cosine plus j times sine, shape (parts,).
    """
    (cosine, sine), (of_cosine, of_sine) = (np.split(one, 2, axis=1) for one in (both, through))
    a, b = (cosine * of_cosine).sum(axis=0), (sine * of_sine).sum(axis=0)
    c = (cosine * of_sine).sum(axis=0)
    mean, radius = (a + b) / 2, np.hypot((a - b) / 2, c)
    return np.stack([mean + radius, mean - radius]), np.exp(0.5j * np.arctan2(2 * c, a - b))


def _turned(both: NDArray[T], along: ComplexArray) -> NDArray[T]:
    """Return cosines and sines, shape (…, 2 parts), along the axes, shape (…, 2, parts)."""
    cosine, sine = np.split(both, 2, axis=1)
    x, y = along.real, along.imag
    return np.asarray(np.stack([x * cosine + y * sine, x * sine - y * cosine], axis=1))


@dataclass(frozen=True, eq=False)
class _Parts:
    """Oscillations e^{(−σ + jν)t} in a record of length 1."""

    decay: FloatArray
    omega: FloatArray
    """σ and ν of each part, as multiples of 1 over the length of the record, shape (parts,)."""
    log_prior: FloatArray
    """Logarithm of the prior probability of each, shape (parts,)."""
    both: FloatArray
    """Chebyshev coefficients of the real parts of all, and then of their imaginary parts, shape
    (DEGREE + 1, 2 parts)."""

    def below(self, top: float) -> _Parts:
        """Return those of a frequency below `top`, and those that hardly oscillate."""
        kept = self.omega < np.maximum(top, self.decay)
        prior = np.exp(self.log_prior) * kept
        for decay in np.unique(self.decay):
            of_decay = self.decay == decay
            prior[of_decay] /= DECAYS * prior[of_decay].sum()
        return _Parts(
            self.decay[kept],
            self.omega[kept],
            np.log(prior[kept]),
            self.both[:, np.tile(kept, 2)],
        )

    def and_also(self, more: _Parts) -> _Parts:
        """Return these parts and, after them, others."""
        own, other = (np.split(one.both, 2, axis=1) for one in (self, more))
        return _Parts(
            np.concatenate([self.decay, more.decay]),
            np.concatenate([self.omega, more.omega]),
            np.concatenate([self.log_prior, more.log_prior]),
            np.hstack([own[0], other[0], own[1], other[1]]),
        )


@lru_cache(1)
def _parts() -> _Parts:
    """Return all parts; they are the same in a record of any length."""
    decays, omegas, densities = [], [], []
    for decay in np.geomspace(SLOWEST, FASTEST, DECAYS):
        omega = np.arange(0.0, HALF_PERIODS * np.pi, FINE * max(decay, np.pi)) + 0.1 * decay
        decays.append(np.full(len(omega), decay))
        omegas.append(omega)
        # Hardly damped parts, σ below `DAMPED` ν, are the less probable the less they are.
        densities.append(np.minimum(1.0, decay / (DAMPED * omega)))
    decay, omega = np.concatenate(decays), np.concatenate(omegas)
    log_prior = np.log(np.concatenate(densities))
    return _Parts(decay, omega, log_prior, _coefficients(decay, omega))


def _lines(tones: FloatArray, top: float) -> _Parts:
    """Return what distortion may add between the tones: products of two or three of them.

    Args:
        tones: Frequencies of the tones, as multiples of 1 over the length of the record.
        top: Frequency below which products count.
    """
    both = np.concatenate([tones, -tones])
    two = _apart((tones[:, None] + both).ravel(), SAME)
    products = np.concatenate([two, (two[:, None] + both).ravel()])
    products = products[np.abs(products) < min(top, HALF_PERIODS * np.pi)]
    omega = _apart(products, LINES_APART)
    from_tone = np.abs(omega[:, None] - tones).min(axis=1)
    omega = omega[(omega > LINES_FROM) & (from_tone > 2 * LINES_APART)]
    decay = np.zeros(len(omega))
    log_prior = np.full(len(omega), -math.log(max(len(omega), 1)))
    return _Parts(decay, omega, log_prior, _coefficients(decay, omega))


def _apart(omega: FloatArray, step: float) -> FloatArray:
    """Return frequencies without their signs, in multiples of a step, rising, each of them once."""
    return np.asarray(np.unique(np.round(np.abs(omega) / step)) * step)


def _coefficients(decay: FloatArray, omega: FloatArray) -> FloatArray:
    nodes = chebpts1(DEGREE + 1)
    turning = np.exp(np.outer((nodes + 1) / 2, 1j * omega - decay))
    both = 2 / len(nodes) * chebvander(nodes, DEGREE).T @ np.hstack([turning.real, turning.imag])
    both[0] /= 2
    return np.asarray(both, dtype=np.float64)


_kept_grid = lru_cache(RECORDS_KEPT)(_Grid.of)


def _median(values: FloatArray, weight: FloatArray) -> float:
    """Return the value up to which half of the weight lies."""
    order = np.argsort(values)
    reached = np.cumsum(weight[order])
    return float(values[order][np.searchsorted(reached, 0.5 * reached[-1])])


def _averaged(values: FloatArray, block: int) -> FloatArray:
    """Return the means of blocks of samples, along the first axis."""
    count = len(values) // block
    return np.asarray(values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1))
