"""The transient that a test leaves: what still rings after the ramp, and how slowly it decays.

After the ramp the reference consists of tones alone, so that everything else in the output is noise
or the decay of what the ramp excited, Σ Re c e^{(−σ + jν)t}. Its slowest σ is measured for nothing,
and with σ and ν known the transient is a few more columns of the least squares that estimate the
tones. Noise does not decay: a transient has to stand out of the same record read backwards.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.fft import next_fast_len
from scipy.ndimage import uniform_filter1d

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import BoolArray, Finding
from nufleet.shared.frequency_test.sinusoid_fit import exponentials
from nufleet.shared.frequency_test.tone_decay import decaying_tone

RATIO_MIN = 30.0
"""Power of a transient over that of the noise at its frequency from which it is believed. Noise
exceeds it with a probability of about 1e-3 in all places of a record together."""

PARTS_MAX = 4
"""Largest number of decaying oscillations that are fitted to a transient."""

DECAYS = 8
"""Number of decay rates at which a transient is sought, between that of the whole record and that
of the fastest tone."""

REFINEMENTS = 240
"""Largest number of places at which a part of a transient is tried. Most take 20; a slow part at
the frequency of a tone, which takes up most of it, is first seen far from where it is found."""

PLACED = 0.01
"""Difference between what places leave, as a multiple of the noise's variance, at which a part is
placed: a tenth of the standard deviation to which the noise lets it be placed at all."""

SETTLING_BLOCKS = 8
"""Smallest number of blocks in the part before the measuring part, where the record allows. What
decays within one block is not told from what decays faster, and must not seem to last."""

NEIGHBOURS = 17
"""Number of frequencies, around a transient's, whose noise it is compared with."""

PHASE_PER_BLOCK = 0.4
"""Phase in rad by which the fastest tone may turn within a block of samples that are averaged."""

DEPENDENT = 1e-4
"""Ratio of singular values below which parts of transients are not told apart."""

HALF = 0.5
"""Share of what tones leave from which a decay is believed without a comparison with noise."""

SAMPLES_MAX = 1000
"""Length of a record, in blocks, from which a transient stands out of it anyway."""

HIGHER = 1.2
"""Highest frequency of a transient, as a multiple of that of the highest tone."""

NOISE_RATIO = 2.0
"""Power of what tones leave over that of white noise from which there is more to explain."""

DEGENERATE = 1e-9
TINY = 1e-300
"""Share of a product of two columns' energies below which the columns are one, and the least energy
that is divided by."""

REAL = 0.1
"""Ratio of frequency and decay rate below which a part does not oscillate."""

NEGLIGIBLE = 1e-5
"""Fraction of the output below which a transient does not matter."""

UNEVEN = 2.0
LASTING = 3e-4
"""Share of the output's deviation in the measuring part below which a decay does no harm."""

SLIGHT_BEFORE = 2e-2
SLIGHT = 1e-3
"""Deviation of what is unexplained in the first third, as a multiple of the rest's, above which
decays do not explain the output, and shares of the output's deviation that are never too much: in
the whole record, and in its measuring part."""

RECORDS_KEPT = 64
RECORD_MAX = 2**18
"""Number of records of which all that does not depend on the output is kept for further robots,
which often settle equally long, and the largest number of entries of one."""

DECAYS_UNTIL_SETTLED = 3.0
"""Number of time constants of the slowest part in a settling time, which leave 5 % of it."""


@dataclass(frozen=True)
class RingDown:
    """The decaying oscillations that a ramp leaves, slowest first."""

    decay_1_s: FloatArray
    """Decay rates σ, shape (parts,)."""
    omega_rad_s: FloatArray
    """Frequencies ν, shape (parts,)."""
    lasting: BoolArray
    """True for those that disturb what is measured, shape (parts,)."""
    unexplained: float = 0.0
    """Deviation of what neither tones nor decays explain before the measuring part, in the output's
    unit."""

    def columns(self, samples: int, sample_time_s: float) -> FloatArray:
        """Return what the transient may consist of, from the ramp on, shape (samples, columns)."""
        times_s = sample_time_s * np.arange(samples, dtype=np.float64)
        columns = decaying(times_s, self.decay_1_s, self.omega_rad_s)
        # A slightly different σ and ν change a part by multiples of these, times t.
        late = times_s[:, None] * columns[:, np.tile(self.lasting, 2)]
        both = np.concatenate([columns, late / times_s[-1]], axis=1)
        # Two parts may be nearly the same, as the poles of a critically damped loop are.
        different, sizes, _ = np.linalg.svd(both, full_matrices=False)
        return different[:, sizes > DEPENDENT * sizes[0]] * math.sqrt(samples)


def still_ringing(found: RingDown, settle_s: float) -> Finding | None:
    """Return the finding that a robot settles more slowly than the test waited; None if it did.

    Its value is the time in s in which the slowest part decays to 5 %.

    Args:
        found: Transient that was left when the measuring part began.
        settle_s: Time that the test waited, after the ramp.
    """
    if not found.lasting.any():
        return None
    slowest = int(np.argmax(found.lasting))
    return ringing(float(found.decay_1_s[slowest]), float(found.omega_rad_s[slowest]), settle_s)


def ringing(
    decay_1_s: float, omega_rad_s: float, settle_s: float, *, at_least: bool = False
) -> Finding | None:
    """Return the finding that a part of a transient lasted longer than a test waited, if it did.

    Args:
        decay_1_s: Its decay rate σ.
        omega_rad_s: Its frequency ν.
        settle_s: Time that the test waited, after the ramp.
        at_least: Whether it may well decay more slowly.
    """
    settling_s = DECAYS_UNTIL_SETTLED / decay_1_s
    if settling_s <= settle_s:
        return None
    return Finding(
        code="ringing",
        text=f"it needs {'at least ' * at_least}{settling_s:.3g} s to settle to 5 %, at "
        f"{omega_rad_s:.3g} rad/s, and the test waited {settle_s:.3g} s",
        value=settling_s,
    )


def ring_down(
    output: FloatArray,
    omega_rad_s: FloatArray,
    top_rad_s: float,
    sample_time_s: float,
    settle_samples: int,
) -> RingDown:
    """Find the transient in the output between the ramps of a test.

    Args:
        output: Output while the reference consists of tones alone, that is while the robot settles
            and is measured, shape (samples,), in any unit.
        omega_rad_s: Frequencies of the tones and their harmonics, shape (F,).
        top_rad_s: Frequency of the highest tone, up to which transients are sought.
        sample_time_s: Time between samples.
        settle_samples: Number of samples before the measuring part.

    Returns:
        The parts of the transient that noise does not hide; none in a record that is too short, or
        that decays do not explain.
    """
    nothing = RingDown(np.empty(0), np.empty(0), np.empty(0, dtype=bool))
    block = int(PHASE_PER_BLOCK / (top_rad_s * sample_time_s))
    if settle_samples > 0:
        block = min(block, max(settle_samples // SETTLING_BLOCKS, len(output) // SAMPLES_MAX))
    block = max(1, block)
    count = len(output) // block
    if count < 4 * len(omega_rad_s) + 8:
        return nothing
    y = output[: count * block].reshape(count, block).mean(axis=1)
    size = _deviation(y)
    if size == 0.0:
        return nothing
    kept = count * (2 * len(omega_rad_s) + 2 + DECAYS) <= RECORD_MAX
    record = (_kept_record if kept else _Record.of)(
        tuple(omega_rad_s.tolist()), HIGHER * top_rad_s, block * sample_time_s, count
    )
    times_s, basis = record.times_s, record.steady
    # White noise, from what neighbouring samples differ by.
    noise = float(np.mean(np.diff(output, 2) ** 2)) / (6 * block)
    tones_rad_s = omega_rad_s[omega_rad_s <= top_rad_s]
    found: list[tuple[float, float]] = []
    for _ in range(PARTS_MAX):
        left = y - basis @ (basis.T @ y)
        if _deviation(left) <= NEGLIGIBLE * size:
            break
        start = _loudest(left, record)
        if start is None and np.var(left) > NOISE_RATIO * noise:
            start = _most(left, basis, times_s, HIGHER * top_rad_s)
        if start is None:
            start = decaying_tone(left, tones_rad_s, times_s[1])
        if start is None:
            break
        decay, omega = _refined(left, basis, times_s, start)
        found.append((decay, omega))
        part = decaying(times_s, np.array([decay]), np.array([omega]))
        part = part[:, : 2 if omega else 1]
        part -= basis @ (basis.T @ part)
        basis = np.concatenate([basis, np.linalg.qr(part)[0]], axis=1)
    first = settle_samples // block
    left = y - basis @ (basis.T @ y)
    steady = record.steady
    # What hardly decays in the record may as well be a drift or a step.
    slow = any(decay * times_s[-1] < 1.0 for decay, _ in found)
    odd = _uneven(left, SLIGHT_BEFORE * size) or _uneven(left[first:], SLIGHT * size)
    if not found or slow or odd:
        steady_left = y - steady @ (steady.T @ y)
        return replace(nothing, unexplained=_deviation(steady_left[:first]) if first else 0.0)
    # Slowest first, and only what is left of them that would disturb the estimates.
    parts = np.array(sorted(found))
    columns = decaying(times_s, parts[:, 0], parts[:, 1])
    free, moved = (one - steady @ (steady.T @ one) for one in (columns, y))
    weights = np.linalg.lstsq(free, moved, rcond=1e-9)[0]
    late = np.mean((columns * weights)[first:] ** 2, axis=0).reshape(2, -1).sum(axis=0)
    lasting = late > np.maximum(np.var(left[first:]) / (count - first), (LASTING * size) ** 2)
    before = _deviation(left[:first]) if first else 0.0
    return RingDown(parts[:, 0], parts[:, 1], lasting, before)


def _uneven(left: FloatArray, slight: float) -> bool:
    """Return whether more is unexplained in the beginning: a crash or a change is no decay."""
    beginning, rest = np.split(left, [len(left) // 3])
    return _deviation(beginning) > max(UNEVEN * _deviation(rest), slight)


def _deviation(values: FloatArray) -> float:
    """Return the standard deviation; `numpy.std` takes three times as long for a short record."""
    centred = values - values.mean()
    return math.sqrt(float(centred @ centred) / len(values))


@dataclass(frozen=True, eq=False)
class _Record:
    """All of a search for a transient that does not depend on the output."""

    times_s: FloatArray
    """Times of the blocks, shape (count,)."""
    steady: FloatArray
    """Orthonormal columns of the tones, offset and drift, shape (count, columns)."""
    decay_1_s: FloatArray
    """Decay rates that are tried first, shape (rates,)."""
    envelopes: FloatArray
    """Decays of those rates, each of energy 1, shape (rates, count)."""
    bins_rad_s: FloatArray
    """Fourier frequencies at which transients are sought, shape (bins,)."""
    padded: int
    """Length to which zeros are added for these: at least twice that of the record, and a product
    of small primes, since transforms of other lengths take up to twenty times as long."""

    @staticmethod
    def of(omega_rad_s: tuple[float, ...], top_rad_s: float, step_s: float, count: int) -> _Record:
        times_s = step_s * np.arange(count, dtype=np.float64)
        turning = exponentials(times_s[1] * np.array(omega_rad_s), count)
        steady = [turning.real, turning.imag, np.ones((count, 1)), times_s[:, None] / times_s[-1]]
        decays = np.geomspace(1 / times_s[-1], max(top_rad_s, 2 / times_s[-1]), DECAYS)
        envelopes = np.exp(-np.outer(decays, times_s))
        padded = next_fast_len(2 * count, real=True)
        bins = np.fft.rfftfreq(padded, times_s[1]) * 2 * np.pi
        arrays = (
            times_s,
            np.linalg.qr(np.concatenate(steady, axis=1))[0],
            decays,
            envelopes / np.sqrt(np.sum(envelopes**2, axis=1))[:, None],
            bins[bins <= top_rad_s],
        )
        for array in arrays:
            array.setflags(write=False)
        return _Record(*arrays, padded)


_kept_record = lru_cache(RECORDS_KEPT)(_Record.of)


def decaying(times_s: FloatArray, decay_1_s: FloatArray, omega_rad_s: FloatArray) -> FloatArray:
    """Return Re e^{(−σ + jν)t} and Im of it for each part, shape (times, 2 parts).

    Args:
        times_s: Times in s from 0 on, evenly spaced, shape (times,).
        decay_1_s: Decay rates σ, shape (parts,).
        omega_rad_s: Frequencies ν, shape (parts,).
    """
    step_s = times_s[1]
    ringing = exponentials(step_s * omega_rad_s, len(times_s), decay=step_s * decay_1_s)
    return np.concatenate([ringing.real, ringing.imag], axis=1)


def _loudest(left: FloatArray, record: _Record) -> tuple[float, float] | None:
    """Return decay and frequency of what most exceeds the noise; None if nothing does."""
    heard = len(record.bins_rad_s)
    half = left[len(left) // 2 :]
    white = _deviation(half) ** 2
    both = np.stack([left, left[::-1]])[:, None] * record.envelopes
    # Noise is averaged over neighbouring frequencies, some of which lie beyond the highest bin.
    lines = np.fft.rfft(both, record.padded)[..., : heard + NEIGHBOURS]
    forwards, backwards = lines.real**2 + lines.imag**2
    noise = np.maximum(uniform_filter1d(backwards, NEIGHBOURS, mode="nearest"), white)
    ratio = (forwards / np.maximum(noise, np.finfo(float).tiny))[:, :heard]
    slow, at = np.unravel_index(np.argmax(ratio), ratio.shape)
    if ratio[slow, at] <= RATIO_MIN:
        return None
    return float(record.decay_1_s[slow]), float(record.bins_rad_s[at])


def _most(
    left: FloatArray, basis: FloatArray, times_s: FloatArray, top_rad_s: float
) -> tuple[float, float] | None:
    """Return decay and frequency of what explains most of the rest; None if less than half of it.

    In a record shorter than the decay, tones take up most of it, and leave something that is loud
    at both ends.
    """
    if len(times_s) > SAMPLES_MAX:
        return None
    best, start = HALF * float(left @ left), None
    for decay in np.geomspace(0.5 / times_s[-1], max(top_rad_s, 2 / times_s[-1]), DECAYS):
        omega = np.arange(0.0, top_rad_s, max(decay, np.pi / times_s[-1])) + REAL * decay
        part = decaying(times_s, np.full(len(omega), decay), omega)
        part = (part - basis @ (basis.T @ part)).reshape(len(times_s), 2, -1)
        (a, b), c = np.sum(part**2, axis=0), np.sum(part[:, 0] * part[:, 1], axis=0)
        u, v = np.tensordot(left, part, 1)
        # The energy that two columns explain, uᵀS⁻¹u with S = [[a, c], [c, b]].
        determinant = np.maximum(a * b - c**2, DEGENERATE * a * b)
        gain = (b * u**2 - 2 * c * u * v + a * v**2) / np.maximum(determinant, TINY)
        if gain.max() > best:
            best, start = float(gain.max()), (float(decay), float(omega[np.argmax(gain)]))
    return start


def _refined(
    left: FloatArray, basis: FloatArray, times_s: FloatArray, start: tuple[float, float]
) -> tuple[float, float]:
    """Return decay and frequency that leave the least, by variable projection."""
    count, step_s, whole = len(times_s), float(times_s[1]), float(left @ left)
    # As in `exponentials`, for a single rate: first along the fine steps, then the coarse ones.
    block = math.isqrt(count)
    rows = -(-count // block)
    steps = np.concatenate([np.arange(block), block * np.arange(rows)]).astype(np.float64)
    columns = np.zeros((rows * block, 1 + basis.shape[1]))
    columns[:count, 0], columns[:count, 1:] = left, basis
    by_fine = columns.reshape(rows, block, -1).transpose(0, 2, 1).reshape(-1, block).astype(complex)
    # Slower than this is not told from offset and drift, faster not from a single block.
    slowest, fastest = math.log(0.3 / float(times_s[-1])), -math.log(step_s)

    def rate_1_s(place: complex) -> complex:
        decay = math.exp(min(max(place.real, slowest), fastest))
        return complex(-decay, abs(place.imag))

    def unexplained(place: complex) -> float:
        rate = step_s * rate_1_s(place)
        turning = np.exp(rate * steps)
        moments = turning[block:] @ (by_fine @ turning[:block]).reshape(rows, -1)
        along, toward = moments[1:], complex(moments[0])
        u, v = toward.real, toward.imag
        # Sums over the samples of |e|² and e², less what lies along the basis.
        whole_power = math.expm1(2 * count * rate.real) / math.expm1(2 * rate.real)
        power = whole_power - float(np.vdot(along, along).real)
        square = _less_one(2 * count * rate) / _less_one(2 * rate) - complex(along @ along)
        a, b, c = (power + square.real) / 2, (power - square.real) / 2, square.imag / 2
        # The sine of a part that does not oscillate is zero, and of what the basis holds nothing is
        # left but rounding errors, of either sign.
        least, determinant = DEGENERATE * whole_power, a * b - c**2
        if min(a, b) <= least or determinant <= DEGENERATE * a * b:
            gain = max(u**2 / a if a > least else 0.0, v**2 / b if b > least else 0.0)
        else:
            gain = (b * u**2 - 2 * c * u * v + a * v**2) / determinant
        return whole - gain

    width = max(start[0], 2 * np.pi / times_s[-1])
    corner = complex(math.log(start[0]), start[1])
    simplex = (corner, corner + 0.7, corner + 0.5j * width)
    found = rate_1_s(_least(unexplained, simplex, REFINEMENTS, PLACED / count))
    decay, omega = -found.real, found.imag
    return decay, omega if omega > REAL * decay else 0.0


def _less_one(exponent: complex) -> complex:
    """Return e^x − 1, which loses no digits where x is small."""
    x, y = exponent.real, exponent.imag
    real = math.expm1(x) * math.cos(y) - 2 * math.sin(y / 2) ** 2
    return complex(real, math.exp(x) * math.sin(y))


def _least(
    cost: Callable[[complex], float], simplex: Sequence[complex], evaluations: int, close: float
) -> complex:
    """Return the best place that a simplex finds (Nelder and Mead, Computer Journal 7, 1965).

    SciPy has this method, too, but its `optimize` takes a fifth of a second to load.

    Args:
        cost: Function of a place in the plane, which is not negative.
        simplex: Three places to begin with.
        evaluations: Number of evaluations from which on no further step is taken.
        close: Difference of the costs, as a share of the least, from which on none is taken either.
    """
    places: list[tuple[float, complex]] = [(cost(place), place) for place in simplex]
    done = len(places)

    def tried(place: complex) -> tuple[float, complex]:
        nonlocal done
        done += 1
        return cost(place), place

    while True:
        places.sort(key=lambda one: one[0])
        (lowest, best), (highest, worst) = places[0], places[-1]
        if done >= evaluations or highest - lowest <= close * lowest:
            return best
        centre = (best + places[1][1]) / 2
        away = centre - worst
        reflected = tried(centre + away)
        if reflected[0] < lowest:
            further = tried(centre + 2 * away)
            places[-1] = min(reflected, further, key=lambda one: one[0])
            continue
        if reflected[0] < places[-2][0]:
            places[-1] = reflected
            continue
        outside = reflected[0] < highest
        nearer = tried(centre + (0.5 if outside else -0.5) * away)
        if nearer[0] < min(reflected[0], highest):
            places[-1] = nearer
        else:
            places = [places[0], *(tried(best + 0.5 * (place - best)) for _, place in places[1:])]
