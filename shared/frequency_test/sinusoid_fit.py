"""Least squares of sinusoids with known frequencies, an offset and a drift, over equal segments."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, TypeVar

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from nufleet.shared.arrays import ComplexArray, FloatArray

CONDITION_MAX = 1e10
"""Condition number of the normal equations above which frequencies cannot be separated."""

KEPT_MAX = 2**20
"""Largest number of entries of a design matrix that is kept in memory."""

DESIGNS_KEPT = 4
"""Number of designs that are kept for further signals: all robots of a round play the same test."""

SCATTER_MIN = 1e-6
"""Fraction of the variance below which the scatter of segments is rounding rather than noise."""


A = TypeVar("A", bound=np.ndarray[Any, Any])


class UnresolvableError(ValueError):
    """Two frequencies are too close (or one too near Nyquist) for the length of the signals."""


@dataclass(frozen=True)
class SinusoidFit:
    """Phasors Y of y(t) = Re Σ Y e^{jωt} + offset + drift at F frequencies."""

    omega_rad_s: FloatArray
    """Frequencies ω, shape (F,)."""
    phasors: ComplexArray
    """Estimated phasors Y, shape (F,), in the signal's unit."""
    segment_phasors: ComplexArray
    """Contribution of each segment to the estimate, shape (segments, F): their mean over segments
    is `phasors`, and if segments hold whole periods they are the phasors fitted to each segment
    alone. Their scatter therefore measures the noise at each frequency, white or not."""
    scatter_factor: FloatArray
    """Factor by which the scatter underestimates the variance, shape (F,); above 1 if segments are
    too short to separate the tones."""
    scatter_degrees: FloatArray
    """Degrees of freedom of the scatter, shape (F,): 2 (segments − 1), or fewer if segments are too
    short to separate the tones."""
    fitted: FloatArray
    """The fit at every sample, shape (samples,), in the signal's unit."""

    @property
    def variance(self) -> FloatArray:
        """Variance E|Ŷ − Y|² of each phasor, shape (F,): s²/P times `scatter_factor`."""
        return np.asarray(self.scatter_factor * variance_of_mean(self.segment_phasors))


def variance_of_mean(segment_values: ComplexArray) -> FloatArray:
    """Return s²/P, the variance of the mean over P segments.

    Args:
        segment_values: One value per segment and quantity, shape (segments, n).

    Returns:
        Variances in the values' unit squared, shape (n,).
    """
    segments = len(segment_values)
    spread = np.abs(segment_values - segment_values.mean(axis=0)) ** 2
    return np.asarray(spread.sum(axis=0) / (segments * (segments - 1)), dtype=np.float64)


def complex_median(segment_values: ComplexArray) -> ComplexArray:
    """Return the median over segments, separately for real and imaginary parts.

    Args:
        segment_values: One value per segment and quantity, shape (segments, n).

    Returns:
        Medians, shape (n,).
    """
    count = len(segment_values)
    both = np.ascontiguousarray(segment_values).view(np.float64)
    ordered = np.sort(both, axis=0)
    middle = (ordered[(count - 1) // 2] + ordered[count // 2]) / 2
    return np.asarray(middle.view(np.complex128))


def fit_sinusoids(
    signals: Sequence[FloatArray],
    omega_rad_s: FloatArray,
    sample_time_s: float,
    segments: int,
    transient: FloatArray | None = None,
) -> list[SinusoidFit]:
    """Fit all frequencies jointly to the whole of each signal.

    With H = [cos ωt, sin ωt, 1, t − t̄] the estimate is θ̂ = (HᵀH)⁻¹Hᵀy. Segment p contributes
    (HᵀH)⁻¹H_pᵀ(y_p − H_p θ̂) to it. These contributions sum to zero; P times each of them, added to
    θ̂, is that segment's own estimate (the clusters of a cluster-robust covariance: Liang and Zeger,
    Biometrika 73, 1986).

    That covariance is too small if segments differ in their information on a parameter (Bell and
    McCaffrey, Survey Methodology 28, 2002): a segment's residual lacks the part of its noise that
    has already entered θ̂. In white noise E[s²/P] is
    P/(P − 1) diag(G⁻¹ (G − Σ_p G_p G⁻¹ G_p) G⁻¹) and the variance is diag(G⁻¹), with G = HᵀH and
    G_p = H_pᵀH_p; the ratio of the two is the `scatter_factor`. The degrees of freedom belong to
    the χ² distribution with the same mean and variance (Satterthwaite, Biometrics Bulletin 2,
    1946).

    Args:
        signals: Signals in any unit, all of the same shape (samples,), where samples is a multiple
            of `segments`.
        omega_rad_s: Frequencies, shape (F,), all different and below the Nyquist frequency.
        sample_time_s: Time between samples.
        segments: Number of segments P of equal length.
        transient: Further columns of H, which a transient consists of, shape (samples, columns).

    Returns:
        One fit per signal, in the same order.

    Raises:
        UnresolvableError: the normal equations are singular to working precision, or leave no
            residual from which the noise could be estimated.
    """
    stacked = np.column_stack(signals)
    samples, count = stacked.shape
    of = (tuple(omega_rad_s.tolist()), sample_time_s, segments, samples)
    kept = transient is None and samples * (2 * len(omega_rad_s) + 2) <= KEPT_MAX
    moments: FloatArray = np.zeros((1, count))

    def add(block: slice, columns: FloatArray) -> None:
        nonlocal moments
        moments = moments + columns.T @ stacked[block]

    if kept:
        design = _kept_design(*of)
        for block, columns in design.blocks():
            add(block, columns)
    else:
        design = _Design.of(*of, transient, add)
    theta = cho_solve(design.factor, moments, check_finite=False)
    frequencies = len(omega_rad_s)

    fitted = np.empty_like(stacked)
    left = np.empty((segments, *moments.shape))
    for p, (block, columns) in enumerate(design.blocks()):
        fitted[block] = columns @ theta
        left[p] = columns.T @ (stacked[block] - fitted[block])
    # The contributions of all segments, shape (columns, segments, signals).
    every = left.transpose(1, 0, 2).reshape(len(moments), -1)
    contributions = cho_solve(design.factor, every, check_finite=False)
    own = theta[:, None] + segments * contributions.reshape(-1, segments, count)
    return [
        SinusoidFit(
            omega_rad_s=omega_rad_s,
            phasors=_phasors(theta[:, s], frequencies),
            segment_phasors=_phasors(own[:, :, s].T, frequencies),
            scatter_factor=design.scatter_factor,
            scatter_degrees=design.scatter_degrees,
            fitted=fitted[:, s],
        )
        for s in range(count)
    ]


def sum_of_tones(
    phasors: ComplexArray, omega_rad_s: FloatArray, sample_time_s: float, samples: int
) -> FloatArray:
    """Return Re Σ Y e^{jωt} at the sampling times t = 0, T, 2T, ….

    Args:
        phasors: Phasors Y in any unit, shape (F,).
        omega_rad_s: Frequencies ω, shape (F,).
        sample_time_s: Time T between samples.
        samples: Number of samples.

    Returns:
        The sum in the phasors' unit, shape (samples,).
    """
    if samples * len(omega_rad_s) <= KEPT_MAX:
        turning = _kept_turning(tuple(omega_rad_s.tolist()), sample_time_s, samples)
    else:
        turning = exponentials(sample_time_s * omega_rad_s, samples)
    return np.asarray((turning @ phasors).real)


@lru_cache(DESIGNS_KEPT)
def _kept_turning(
    omega_rad_s: tuple[float, ...], sample_time_s: float, samples: int
) -> ComplexArray:
    return _shared(exponentials(sample_time_s * np.array(omega_rad_s), samples))


def exponentials(
    phase_rad: FloatArray, samples: int, first: int = 0, decay: FloatArray | float = 0.0
) -> ComplexArray:
    """Return e^{(−decay + j phase) k} at k = first, first + 1, …, shape (samples, rates).

    k = first + Ba + b makes each of them a product of two factors, of which there are only about
    2√samples; a product takes a tenth of the time of an exponential.

    Args:
        phase_rad: Phases per sample in rad, shape (rates,).
        samples: Number of samples.
        first: Index of the first sample.
        decay: Decays per sample, not negative, shape (rates,).
    """
    rates: ComplexArray = np.asarray(1j * phase_rad - decay, dtype=np.complex128)
    block = max(1, math.isqrt(samples))
    coarse = np.exp(np.outer(first + block * np.arange(-(-samples // block)), rates))
    fine = np.exp(np.outer(np.arange(block), rates))
    return np.asarray((coarse[:, None] * fine).reshape(-1, len(rates))[:samples])


def resolvable_harmonics(
    omega_rad_s: FloatArray, sample_time_s: float, duration_s: float
) -> FloatArray:
    """Return 2ω and 3ω of each tone ω, except those too close to a tone, Nyquist or each other.

    Frequencies are too close if they differ by less than one period in `duration_s`.

    Args:
        omega_rad_s: Frequencies of the tones, shape (F,).
        sample_time_s: Time between samples.
        duration_s: Duration of the signal that they will be fitted to.

    Returns:
        Harmonic frequencies in rad/s, shape (h,) with h ≤ 2 F.
    """
    resolution_rad_s = 2 * np.pi / duration_s
    taken = [np.pi / sample_time_s, *omega_rad_s.tolist()]
    kept: list[float] = []
    for order in (2, 3):
        for omega in omega_rad_s.tolist():
            harmonic = order * omega
            above_nyquist = harmonic >= np.pi / sample_time_s
            if not above_nyquist and min(abs(harmonic - t) for t in taken) >= resolution_rad_s:
                taken.append(harmonic)
                kept.append(harmonic)
    return np.array(kept)


def _scatter(
    factor: tuple[FloatArray, bool], grams: FloatArray, frequencies: int
) -> tuple[FloatArray, FloatArray]:
    """Compare s²/P of each phasor with its variance in white noise, see `fit_sinusoids`.

    Args:
        factor: Cholesky factor of G, as returned by `cho_factor`.
        grams: G_p of each segment, shape (segments, columns, columns).
        frequencies: Number F of frequencies, whose columns are the first 2F.

    Returns:
        The factor by which s²/P underestimates the variance, and the degrees of freedom of s²/P,
        both of shape (F,).
    """
    segments, size, _ = grams.shape
    inverse = cho_solve(factor, np.eye(size), check_finite=False)
    # Columns of G⁻¹ for cos and sin of each frequency: (size, 2, F).
    both = inverse[:, : 2 * frequencies].reshape(size, 2, frequencies)
    # The contributions of segments p and q have the covariance δ_pq G⁻¹G_pG⁻¹ − G⁻¹G_pG⁻¹G_qG⁻¹,
    # of which each frequency has a block of shape (2 segments, 2 segments).
    through = grams @ inverse[:, : 2 * frequencies]
    back = inverse @ through
    rows, columns = (
        one.reshape(segments, size, 2, frequencies).transpose(3, 0, 2, 1) for one in (back, through)
    )
    covariance = -(
        rows.reshape(frequencies, 2 * segments, size)
        @ columns.reshape(frequencies, 2 * segments, size).transpose(0, 2, 1)
    ).reshape(frequencies, segments, 2, segments, 2)
    of_own = np.einsum("saf,fpbs->fpab", both, columns)
    each = np.arange(segments)
    covariance[:, each, :, each] += of_own.transpose(1, 0, 2, 3)
    total = np.einsum("fpapa->f", covariance)
    squares = np.sum(covariance**2, axis=(1, 2, 3, 4))
    # s² is a quadratic form in the contributions: its mean is the trace of their covariance, its
    # variance twice the squared Frobenius norm, so Satterthwaite's degrees are trace² / norm².
    expected = segments / (segments - 1) * total
    diagonal = np.diag(inverse)
    variance = diagonal[:frequencies] + diagonal[frequencies : 2 * frequencies]
    if np.any(expected <= SCATTER_MIN * variance):
        raise UnresolvableError("the signals are too short to separate their noise from the tones")
    return np.asarray(variance / expected), np.asarray(total**2 / squares)


@dataclass(frozen=True, eq=False)
class _Design:
    """All of a fit that does not depend on the signals."""

    segments: int
    columns_of: _Columns
    kept: tuple[FloatArray, ...]
    """The rows of H for each segment; none if they take too much memory."""
    factor: tuple[FloatArray, bool]
    """Cholesky factor of HᵀH, as returned by `cho_factor`."""
    scatter_factor: FloatArray
    scatter_degrees: FloatArray

    @staticmethod
    def of(
        omega_rad_s: tuple[float, ...],
        sample_time_s: float,
        segments: int,
        samples: int,
        transient: FloatArray | None = None,
        seen: Callable[[slice, FloatArray], None] = lambda block, columns: None,
    ) -> _Design:
        """Factorise; `seen` receives each block of rows of H. Raises UnresolvableError."""
        columns_of = _Columns(samples, np.array(omega_rad_s), sample_time_s, transient)
        size = columns_of.count
        grams = np.empty((segments, size, size))
        # H is needed twice. Of many tones in a long test it would take gigabytes, so that it is
        # made twice, one segment at a time.
        kept = []
        for p, block in enumerate(_blocks(samples, segments)):
            columns = columns_of(block)
            grams[p] = columns.T @ columns
            seen(block, columns)
            if samples * size <= KEPT_MAX:
                kept.append(_shared(columns))
        gram = grams.sum(axis=0)
        eigenvalues = np.linalg.eigvalsh(gram)
        if eigenvalues[-1] > CONDITION_MAX * eigenvalues[0]:
            raise UnresolvableError("signals of this length cannot resolve the frequencies")
        factor = cho_factor(gram)
        scatter = map(_shared, _scatter(factor, grams, len(omega_rad_s)))
        return _Design(segments, columns_of, tuple(kept), factor, *scatter)

    def blocks(self) -> Iterator[tuple[slice, FloatArray]]:
        """Yield the samples of each segment, and the rows of H for them."""
        for p, block in enumerate(_blocks(self.columns_of.samples, self.segments)):
            yield block, self.kept[p] if self.kept else self.columns_of(block)


@lru_cache(DESIGNS_KEPT)
def _kept_design(
    omega_rad_s: tuple[float, ...], sample_time_s: float, segments: int, samples: int
) -> _Design:
    return _Design.of(omega_rad_s, sample_time_s, segments, samples)


def _blocks(samples: int, segments: int) -> list[slice]:
    length = samples // segments
    return [slice(p * length, (p + 1) * length) for p in range(segments)]


def _shared(array: A) -> A:
    """Return an array that several threads use, which none of them may write to."""
    array.setflags(write=False)
    return array


@dataclass(frozen=True, eq=False)
class _Columns:
    """The matrix H, of which a block of rows is made at a time."""

    samples: int
    omega_rad_s: FloatArray
    sample_time_s: float
    transient: FloatArray | None

    @property
    def count(self) -> int:
        """Number of columns."""
        more = 0 if self.transient is None else self.transient.shape[1]
        return 2 * len(self.omega_rad_s) + 2 + more

    def __call__(self, block: slice) -> FloatArray:
        index = np.arange(block.start, block.stop)
        turning = exponentials(self.sample_time_s * self.omega_rad_s, len(index), block.start)
        drift = (2.0 * index - (self.samples - 1)) / self.samples
        more = [] if self.transient is None else [self.transient[block]]
        return np.column_stack([turning.real, turning.imag, np.ones(len(index)), drift, *more])


def _phasors(theta: FloatArray, frequencies: int) -> ComplexArray:
    """Turn a, b of a cos ωt + b sin ωt, which lead θ, into a − jb; shape (…, columns) to (…, F)."""
    return theta[..., :frequencies] - 1j * theta[..., frequencies : 2 * frequencies]
