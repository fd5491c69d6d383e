"""The transient that the tones of a test may hide.

A part of the transient that decays within the record stands out of it, and `ring_down` finds it.
One that outlasts the record, at a frequency near a tone or below all of them, looks like that tone,
or like an offset and a drift: many decay rates σ and frequencies ν explain the record equally well,
and each of them says something else about the tones. So none is chosen here. All are averaged,
weighted by how well they explain the record (Bayesian model averaging: Hoeting et al., Statistical
Science 14, 1999), and the tones are less certain by what they would do to them.

What a robot that is not linear adds at sums and differences of its tones explains a record as well
as a slow transient does, and is no reason to wait. It differs in that it adds something at many of
them. So all are averaged over distortion of several sizes, too: at each size, the amplitudes of all
sums and differences are Gaussian and independent, and one of them may be larger.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
from numpy.polynomial.chebyshev import chebvander
from scipy.ndimage import uniform_filter1d

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.frequency_test.repetition import differences
from nufleet.shared.frequency_test.ring_down import (
    HIGHER,
    PHASE_PER_BLOCK,
    SAMPLES_MAX,
    RingDown,
    ringing,
)
from nufleet.shared.frequency_test.sinusoid_fit import exponentials
from nufleet.shared.frequency_test.transient_parts import (
    DEGREE,
    HALF_PERIODS,
    LINES_TO,
    Parts,
    distortion,
    ringing_parts,
)

CERTAIN = 0.95
"""Probability of a transient from which it is a finding."""

EXPECTED = 0.65
"""Prior probability that something still rings."""

DIFFERENCES_MIN = 12
"""Least number of differences between two periods that tell whether something rings."""

SURELY = 0.8
PROBABLE = 0.5
"""Probability with which a transient decays at least as slowly as is found amid distortion, and
that of distortion from which a finding says so."""

AT_ONCE = 20.0
"""Decay rate from which a transient is gone at once, per length of the record."""

SIZES = (0.5, 0.15)
"""Prior standard deviations of what rings at the beginning, as multiples of the deviation of the
output; each is as probable as the others. With the largest alone, a transient that is hardly larger
than the noise would be held to be none."""

BENT = 0.5
DISTORTIONS = (0.1, 0.03, 0.01, 0.003, 0.001)
"""Prior probability that there is distortion, and standard deviations of the amplitudes of its
lines, as multiples of the deviation of the output."""

OUTSTANDING = 0.5
LARGER = 3.0
"""Prior probability that one line, a product of three tones, is larger than the others, and how
many times larger: where a loop saturates, that next to the highest tones is."""

ASKED = 0.5
"""Probability that something rings, if there is no distortion, from which there may be some."""

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
    """Probability that there is one; amid distortion at most that by what does not repeat."""
    decay_1_s: float
    """Decay rate σ that it exceeds as probably as not, if there is one, and amid distortion with a
    probability of 1 − `SURELY`; infinite where that is so large that it decays at once."""
    omega_rad_s: float
    """Its most probable frequency ν."""
    variance: FloatArray
    """Mean square by which it moves each tone's phasor, shape (tones,), in the output's unit."""
    distorted: float
    """Probability that there is distortion, 0 where its absence was not doubted."""
    at_least: bool = False
    """Whether it may well decay more slowly."""


def may_ring(hidden: HiddenTransient | None, settle_s: float) -> Finding | None:
    """Return the finding that a robot settles more slowly than the test waited; None if it did.

    Args:
        hidden: What the tones may hide of it; None if nothing is known of that.
        settle_s: Time that the test waited, after the ramp.
    """
    if hidden is None or hidden.probability < CERTAIN:
        return None
    return ringing(hidden.decay_1_s, hidden.omega_rad_s, settle_s, at_least=hidden.at_least)


def told_from_tones(ringing: RingDown, length_s: float) -> bool:
    """Return whether what was found to ring longest is too fast to hide behind tones."""
    slowest = int(np.argmax(ringing.lasting))
    return float(ringing.omega_rad_s[slowest]) * length_s > HALF_PERIODS * math.pi


def hidden_transient(
    output: FloatArray,
    omega_rad_s: FloatArray,
    tones: int,
    sample_time_s: float,
    settle_samples: int,
    waited_s: float,
    found: FloatArray | None = None,
    period: int | None = None,
) -> HiddenTransient | None:
    """Return what the tones may hide; None if that cannot be told in a record like this.

    Whether there is distortion is asked, which takes most of the time, only where its absence would
    mean that something rings longer than the test waited, or moves a tone by more than noise does.

    Args:
        output: Output while the reference consists of tones alone, that is while the robot settles
            and is measured, shape (samples,), in any unit.
        omega_rad_s: Frequencies of the tones and, after them, of their harmonics, shape (F,).
        tones: Number of tones.
        sample_time_s: Time between samples.
        settle_samples: Number of samples before those that the tones are fitted to.
        waited_s: Time that the test waited, after the ramp.
        found: Transient that was found already, shape (samples, columns); None if none was.
        period: Number of samples after which all tones repeat; None if they do not.
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
    heard, steady, energy = grid.left_of(y)
    noise = grid.noise(steady, energy, white)
    if noise is None:
        return None
    straight = grid.straight(heard, noise, size)
    hidden = _believed(grid, [straight])
    of_noise = 4 * noise / (count - first)
    slight = may_ring(hidden, waited_s) is None and np.all(hidden.variance < of_noise)
    if hidden.probability < ASKED or slight:
        return hidden
    bent = [grid.bent.weighed(heard, noise, size, share * size) for share in DISTORTIONS]
    apart = None
    if period is not None:
        turning = exponentials(sample_time_s * omega_rad_s[:tones], len(output))
        drift = np.linspace(-1, 1, len(output))[:, None]
        columns = [turning.real, turning.imag, np.ones_like(drift), drift]
        if found is not None:
            columns.append(found[left_out:])
        rates = block * sample_time_s * np.stack([grid.decay_1_s, grid.omega_rad_s])
        changed, parts = differences(output, np.hstack(columns), rates, period, block)
        if len(changed) >= DIFFERENCES_MIN:
            along = np.tensordot(changed, parts, 1) / (2 * noise)
            products = _power(parts) / (2 * noise)
            apart = _Weighed.of(along, products, _prior(size), grid.log_prior)
    return _believed(grid, [straight, *bent], apart)


@dataclass(frozen=True, eq=False)
class _Weighed:
    """How probable each part is that a record may hold, with distortion of one size."""

    log_weight: FloatArray
    """Logarithm of the weight of each part, those that ring first, and of none of them last, shape
    (parts + 1,)."""
    moments: FloatArray
    """Posterior mean of each cosine's squared amplitude, of the product of both amplitudes, and of
    the sine's squared amplitude, shape (3, parts)."""

    @staticmethod
    def of(
        along: FloatArray, products: FloatArray, prior: FloatArray, log_prior: FloatArray
    ) -> _Weighed:
        """Weigh parts by what they explain.

        Args:
            along: Products of the record with each cosine and each sine, shape (2, parts), as
                multiples of the variance of all else, like the following.
            products: Products of the two with themselves and each other, shape (3, parts).
            prior: Prior variances of both amplitudes of each, equally probable ones, shape
                (variances, parts), or those of all, shape (variances, 1).
            log_prior: Logarithm of the weight of each, if it explained nothing, and of none, shape
                (parts + 1,).
        """
        cc, cs, ss = prior * products[:, None]
        # The posterior covariance of both amplitudes is the inverse of 1/prior and the products.
        det = (1 + cc) * (1 + ss) - cs**2
        share = prior / det
        xx, xy, yy = (1 + ss) * share, -cs * share, (1 + cc) * share
        u, v = along
        x, y = xx * u + xy * v, xy * u + yy * v
        explained = 0.5 * (u * x + v * y - np.log(det))
        most = explained.max(axis=0)
        of_size = np.exp(explained - most)
        total = of_size.sum(axis=0)
        log_weight = log_prior.copy()
        log_weight[:-1] += most + np.log(total / len(prior))
        moments = np.stack([xx + x**2, xy + x * y, yy + y**2])
        return _Weighed(log_weight, (moments * of_size).sum(axis=1) / total)

    @property
    def shares(self) -> FloatArray:
        """Probability of each part and, last, of none, shape (parts + 1,)."""
        weight = np.exp(self.log_weight - self.log_weight.max())
        return np.asarray(weight / weight.sum())


def _believed(
    grid: _Grid, cases: Sequence[_Weighed], apart: _Weighed | None = None
) -> HiddenTransient:
    """Return what is believed if one of several cases holds, of which the first has no lines.

    Args:
        grid: What may ring.
        cases: How probable each part is in each case.
        apart: How probable each is by nothing but what does not repeat; None if that is not known.
    """
    most = max(float(case.log_weight.max()) for case in cases)
    weights = [np.exp(case.log_weight - most) for case in cases]
    total = sum(float(weight.sum()) for weight in weights)
    straight, *bent = (grid.slower(weight / total) for weight in weights)
    slow_bent = np.sum([np.zeros_like(straight), *bent], axis=0)
    distorted = sum(float(weight.sum()) for weight in weights[1:]) / total
    share = 0.5
    if apart is not None:
        slow_bent = np.minimum(slow_bent, distorted * grid.slower(apart.shares))
        share += (SURELY - share) * distorted
    slower = straight + slow_bent
    variance = np.zeros(len(grid.moved))
    for case, weight in zip(cases, weights, strict=True):
        moved = grid.moved if case is cases[0] else grid.bent.moved
        variance += np.tensordot(moved, case.moments * weight[:-1], 2) / total
    rings = np.sum([weight[: grid.ringing] for weight in weights], axis=0)
    levels = np.unique(grid.decay_1_s)
    decay_1_s = float(levels[np.searchsorted(slower, share * slower[-1])])
    return HiddenTransient(
        float(slower[-1]),
        decay_1_s if decay_1_s < AT_ONCE / grid.length_s else math.inf,
        float(grid.omega_rad_s[np.argmax(rings)]),
        variance,
        distorted,
        apart is not None and distorted > PROBABLE,
    )


@dataclass(frozen=True, eq=False)
class _Left:
    """What steady columns leave of polynomials, along orthonormal sums of what they leave."""

    sums: FloatArray
    """Coefficients of the polynomials in these sums, shape (DEGREE + 1, directions)."""
    along: FloatArray
    """What is left of each polynomial along each of them, shape (directions, DEGREE + 1)."""

    @staticmethod
    def of(products: FloatArray) -> _Left:
        """Return it for products of what is left of polynomials, (DEGREE + 1, DEGREE + 1)."""
        energies, axes = np.linalg.eigh(products)
        kept = energies > DEPENDENT * energies[-1]
        axes, lengths = axes[:, kept], np.sqrt(energies[kept])
        return _Left(axes / lengths, lengths[:, None] * axes.T)

    def parts(self, both: FloatArray) -> FloatArray:
        """Return cosines and sines of parts along each direction, shape (directions, 2, parts)."""
        return np.asarray((self.along @ both).reshape(len(self.along), 2, -1))


@dataclass(frozen=True, eq=False)
class _Grid:
    """What may ring in a record of tones; nothing in it depends on the output."""

    tones: FloatArray
    """Frequencies of the tones, as multiples of 1 over the length of the record, shape (tones,)."""
    rings: Parts
    """All parts that may ring."""
    decay_1_s: FloatArray
    omega_rad_s: FloatArray
    """Decay rate σ and frequency ν of each, shape (ringing,)."""
    length_s: float
    """Length of the record in s."""
    basis: FloatArray
    """Orthonormal columns: tones, an offset and a drift, and after them harmonics that are slow
    enough to be lines, shape (count, columns)."""
    taken: FloatArray
    """Products of the latter and the polynomials, shape (slow columns, DEGREE + 1)."""
    polynomials: FloatArray
    """Polynomials of which all parts are sums, shape (count, DEGREE + 1)."""
    phasors: ComplexArray
    """Phasors that the tones get from each of them, shape (tones, DEGREE + 1)."""
    left: _Left
    """What the columns without the slow harmonics leave."""
    parts: FloatArray
    """Cosine and sine of each part along each of its directions, shape (directions, 2, ringing)."""
    power: FloatArray
    """Squared cosine, cosine times sine and squared sine in all directions, shape (3, ringing)."""
    moved: FloatArray
    """Mean square by which parts, if they are mistaken for tones, move their phasors, per unit of
    each of the moments of their amplitudes, shape (tones, 3, ringing)."""
    steady: _Left
    """What all columns leave."""
    decaying: FloatArray
    """Cosine and sine of each part along each of its directions, shape (directions, 2, ringing)."""
    inverse: FloatArray
    """Inverse of the products of the two with themselves and each other: for the cosine, for both,
    and for the sine, shape (3, ringing)."""

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
        omegas = length_s * np.array(omega_rad_s)
        turning = exponentials(omegas / (count - 1), count)
        drift = np.linspace(-1, 1, count)
        columns = [turning.real, turning.imag, np.ones((count, 1)), drift[:, None]]
        if found is not None:
            columns.append(found)
        steady = np.concatenate(columns, axis=1)
        polynomials = np.asarray(chebvander(drift, DEGREE), dtype=np.float64)
        rings = ringing_parts(HIGHER * float(omegas[:tones].max()))
        # Slow harmonics are among the lines.
        slow = omegas < LINES_TO
        slow[:tones] = False
        last = np.zeros(steady.shape[1], dtype=bool)
        last[: 2 * frequencies] = np.tile(slow, 2)
        basis = np.linalg.qr(np.hstack([steady[:, ~last], steady[:, last]]))[0]
        taken, free = basis.T @ polynomials, int(np.sum(~last))
        products = polynomials.T @ polynomials - taken[:free].T @ taken[:free]
        left, all_left = _Left.of(products), _Left.of(products - taken[free:].T @ taken[free:])
        parts, decaying = left.parts(rings.both), all_left.parts(rings.both)
        # The tones are fitted to the measuring part alone.
        late, triangle = np.linalg.qr(steady[first:])
        theta = np.linalg.solve(triangle, late.T @ polynomials[first:])
        phasors = theta[:tones] - 1j * theta[frequencies : frequencies + tones]
        return _Grid(
            omegas[:tones],
            rings,
            rings.decay / length_s,
            rings.omega / length_s,
            length_s,
            basis,
            taken[free:],
            polynomials,
            phasors,
            left,
            parts,
            _power(parts),
            _moved(phasors, rings),
            all_left,
            decaying,
            _inverse(_power(decaying), TINY * count),
        )

    @property
    def ringing(self) -> int:
        """Number of parts that may ring."""
        return len(self.decay_1_s)

    @cached_property
    def bent(self) -> _Bent:
        """The same for a record that may hold distortion, too."""
        return _Bent.of(self)

    @cached_property
    def log_prior(self) -> FloatArray:
        """Logarithm of the prior probability of each part and, last, of none, (ringing + 1,)."""
        return np.asarray(np.log(np.append(EXPECTED * self.rings.probability, 1 - EXPECTED)))

    def slower(self, weight: FloatArray) -> FloatArray:
        """Return the weight of what rings and decays at most as fast as each of the decay rates."""
        _, of = np.unique(self.decay_1_s, return_inverse=True)
        return np.asarray(np.cumsum(np.bincount(of, weight[: self.ringing])))

    def left_of(self, y: FloatArray) -> tuple[FloatArray, FloatArray, float]:
        """Return what is left of an output, shape (count,).

        Returns:
            What is left without the slow harmonics, along each of its directions; what is left with
            them, likewise; and the energy of the latter.
        """
        size = self.basis.T @ y
        free = len(size) - len(self.taken)
        rest = y - self.basis @ size
        steady = rest @ self.polynomials
        own = steady + size[free:] @ self.taken
        return own @ self.left.sums, steady @ self.steady.sums, float(rest @ rest)

    def straight(self, heard: FloatArray, noise: float, size: float) -> _Weighed:
        """Return how probable each part is if there is no distortion.

        Args:
            heard: What is left of the output along each direction, shape (directions,).
            noise: Variance of the noise.
            size: Deviation of the output.
        """
        none = math.log(1 - BENT) - 0.5 * float(heard @ heard) / noise
        along = np.tensordot(heard / noise, self.parts, 1)
        log_prior = self.log_prior + none - 0.5 * len(heard) * math.log(noise)
        return _Weighed.of(along, self.power / noise, _prior(size), log_prior)

    def noise(self, heard: FloatArray, energy: float, white: float) -> float | None:
        """Return the variance of the noise in what the columns leave; None if it is not white.

        Args:
            heard: What they leave of the output along each direction, shape (directions,).
            energy: Energy of all that they leave.
            white: Variance of white noise, from neighbouring samples.
        """
        slowest = int(np.sum(self.decay_1_s == self.decay_1_s[0]))
        around = min(NEIGHBOURS, slowest)
        degrees = len(self.basis) - self.basis.shape[1]
        energies = self._energies(heard)
        for _ in range(EXPLAINED):
            near = self._near(int(np.argmax(energies)))
            explained = near @ np.linalg.lstsq(near, heard, rcond=DEPENDENT)[0]
            energy -= float(explained @ explained)
            heard = heard - explained
            degrees -= near.shape[1]
            energies = self._energies(heard)
            level = uniform_filter1d(energies[:slowest] / 2, around, mode="nearest")
            if level.max() <= WHITE * white:
                return float(max(white, energy / degrees))
        return None

    def _near(self, part: int) -> FloatArray:
        """Return a part and its derivative with respect to σ and ν, shape (directions, 4).

        They are nearly all that a transient between the parts of the grid consists of.
        """
        own = self.rings.both[:, [part, self.ringing + part]]
        # x T_n = (T_{n − 1} + T_{n + 1})/2, and x T_0 = T_1.
        late = np.zeros_like(own)
        late[:-1] = own[1:] / 2
        late[1:] += own[:-1] / 2
        late[1] += own[0] / 2
        return np.asarray(self.steady.along @ np.hstack([own, late]))

    def _energies(self, heard: FloatArray) -> FloatArray:
        """Return the energy that each part that rings explains, shape (ringing,)."""
        b = np.tensordot(heard, self.decaying, 1)
        xx, xy, yy = self.inverse
        return np.asarray(xx * b[0] ** 2 + 2 * xy * b[0] * b[1] + yy * b[1] ** 2)


@dataclass(frozen=True, eq=False)
class _Bent:
    """What may ring, or be larger than other lines, in a record of tones that holds distortion."""

    ringing: int
    """Number of parts that may ring. After them come lines that may be larger than others."""
    log_prior: FloatArray
    """Logarithm of the prior probability of each part and, last, of none, shape (parts + 1,)."""
    axes: FloatArray
    """Axes along which lines are independent, in what the columns without the slow harmonics leave,
    shape (directions, directions)."""
    lines: FloatArray
    """Mean square of lines of unit deviation along each, shape (directions,)."""
    parts: FloatArray
    """Cosine and sine of each part along each, shape (directions, 2, parts)."""
    products: FloatArray
    """Squared cosine, cosine times sine and squared sine, shape (directions, 3, parts)."""
    moved: FloatArray
    """Mean square by which parts, if they are mistaken for tones, move their phasors, per unit of
    each of the moments of their amplitudes, shape (tones, 3, parts)."""

    @staticmethod
    def of(grid: _Grid) -> _Bent:
        of_two, of_three = distortion(grid.tones)
        of_lines = grid.left.along @ np.hstack([of_two.both, of_three.both])
        lines, axes = np.linalg.eigh(of_lines @ of_lines.T)
        parts = np.concatenate([grid.parts, grid.left.parts(of_three.both)], axis=2)
        parts = np.tensordot(axes.T, parts, 1)
        prior = [
            EXPECTED * grid.rings.probability,
            (1 - EXPECTED) * OUTSTANDING * of_three.probability,
            np.array([(1 - EXPECTED) * (1 - OUTSTANDING)]),
        ]
        return _Bent(
            grid.ringing,
            np.log(np.concatenate(prior)),
            axes,
            np.maximum(lines, 0.0),
            parts,
            np.stack([parts[:, 0] ** 2, parts[:, 0] * parts[:, 1], parts[:, 1] ** 2], axis=1),
            np.concatenate([grid.moved, _moved(grid.phasors, of_three)], axis=2),
        )

    def weighed(self, heard: FloatArray, noise: float, size: float, line: float) -> _Weighed:
        """Return how probable each part is with distortion of one size.

        Args:
            heard: What is left of the output along each direction of the grid, (directions,).
            noise: Variance of the noise.
            size: Deviation of the output.
            line: Standard deviation of the amplitudes of lines.
        """
        heard = heard @ self.axes
        variance = noise + line**2 * self.lines
        none = math.log(BENT / len(DISTORTIONS))
        none -= 0.5 * float((np.log(variance) + heard**2 / variance).sum())
        prior = np.tile(_prior(size), self.parts.shape[2])
        prior[:, self.ringing :] = (LARGER * line) ** 2
        along = np.tensordot(heard / variance, self.parts, 1)
        products = np.tensordot(1 / variance, self.products, 1)
        return _Weighed.of(along, products, prior, self.log_prior + none)


def _prior(size: float) -> FloatArray:
    """Return prior variances of what rings in an output of this deviation, shape (variances, 1)."""
    return np.square(size * np.array(SIZES))[:, None]


def _power(parts: FloatArray) -> FloatArray:
    """Return products of both columns of pairs with themselves and each other, (3, pairs)."""
    x, y = parts[:, 0], parts[:, 1]
    return np.stack([(x * x).sum(axis=0), (x * y).sum(axis=0), (y * y).sum(axis=0)])


def _inverse(power: FloatArray, least: float) -> FloatArray:
    """Return the inverse of such products, to which a least energy is added."""
    xx, xy, yy = power[0] + least, power[1], power[2] + least
    return np.asarray(np.stack([yy, -xy, xx]) / (xx * yy - xy**2))


def _moved(phasors: ComplexArray, parts: Parts) -> FloatArray:
    """Return by what parts move the phasors of the tones, shape (tones, 3, parts)."""
    both = (phasors @ parts.both).reshape(len(phasors), 2, -1)
    x, y = both[:, 0], both[:, 1]
    return np.stack([np.abs(x) ** 2, 2 * (x * y.conj()).real, np.abs(y) ** 2], axis=1)


_kept_grid = lru_cache(RECORDS_KEPT)(_Grid.of)


def _averaged(values: FloatArray, block: int) -> FloatArray:
    """Return the means of blocks of samples, along the first axis."""
    count = len(values) // block
    return np.asarray(values[: count * block].reshape(count, block, *values.shape[1:]).mean(axis=1))
