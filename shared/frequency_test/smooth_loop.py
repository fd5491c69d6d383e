"""A smooth response, transients and noise fitted to the spectra of records of any reference.

On the lines of the discrete Fourier transform of a record the output of a stable loop is exactly
Y = G U + T + V (Pintelon and Schoukens, System Identification, 2nd ed., sec. 2.6): T is the
transient of what moved before the record, less what still moves after its end, and as smooth as G.
Both are sums of decaying taps with Gaussian weights (Lataire and Chen, Automatica 72, 2016), so
that T, whose size is learned with the noise and the decay from the evidence, can be subtracted from
each line. T has the poles of G: a first fit finds G, and a second one models T as G times taps, so
that a resonance is where both are large.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_solve, cholesky, solve_triangular

from nufleet.shared.arrays import ComplexArray, FloatArray

TAPS_BANDWIDTH = 3.2
"""Half the period of G and T in ω as a multiple of the highest frequency; beyond it, they repeat.
A loop that is not periodic needs room to bend back, and taps far apart could not tell a fast loop
from one that knows its reference in advance."""

TAPS_MAX = 128
"""Largest number of taps of G, and of the T of each record."""

NOISE_ABOVE = (1.5, 4.0)
"""Frequencies between which the output is taken for noise, as multiples of the highest."""

NOISE_MIN = 1e-5
"""Least noise assumed, as a share of the output's deviation. A simulated robot may have none, and
rounding would then decide the regression, which smooth references leave nearly singular."""

_GRID: Mapping[str, tuple[float, ...]] = {
    "noise_ratio": tuple(2.0**power for power in range(-1, 16)),
    "memory": (1.5, 3.0, 6.0, 12.0, 24.0, 48.0, 96.0),
    "size": (1.0, 3.0, 10.0),
    "transient": (0.0, 1e-2, 1e-1, 1.0),
    "colour": (0.0, 1.0, 2.0),
}
_ASCENTS = 4
_LIKELY_MAX = 24

TRANSIENT_AHEAD_S = 1.5
"""Time by which a transient may begin before the delay of the loop has passed, times the highest
frequency: what moves on after a record's end was in the loop before it."""

_NOISE_RATIO_SLOPE = 0.15
"""Exponent of the prior of the noise's power over its power above the band. Disturbances are
stronger where the loop is slow, so the prior is wide; below the power above the band is nothing."""


@dataclass(frozen=True, eq=False)
class Lines:
    """The Fourier lines of one record, of the differences of its samples."""

    omega_rad_s: FloatArray
    """Frequencies of the lines in rad/s, rising, shape (lines,)."""
    u: ComplexArray
    """Transform of the reference's differences, shape (lines,)."""
    y: ComplexArray
    """Transform of the output's differences, shape (lines,)."""
    noise_gain: FloatArray
    """Power of the differences' transform for white noise of variance 1 on the output's samples,
    shape (lines,)."""
    end_gain: float
    """Power that the noise of the first and the last sample adds at every line, for the same."""
    scale: float
    """Standard deviation of the output, the scale of its transients."""


@dataclass(frozen=True)
class Smoothness:
    """The size and shape of what was fitted."""

    noise_ratio: float = 4.0
    """Power of the noise in the band over its power above the band."""
    memory: float = 6.0
    """Time over which the taps decay by a factor e, times the highest frequency."""
    size: float = 1.0
    """Root mean square of G over the frequencies."""
    transient: float = 0.1
    """Size of the transients, relative to the output."""
    colour: float = 0.0
    """Exponent p of the noise's power, which rises as ω^(−p) towards low frequencies."""


@dataclass(frozen=True, eq=False)
class SmoothLoop:
    """The fit, and what is left of each line when the transient is subtracted."""

    z: tuple[ComplexArray, ...]
    """(Y − T)/U of each record, shape (lines,) each."""
    noise: tuple[FloatArray, ...]
    """Variance of each by the noise of its own line, shape (lines,) each."""
    transient: tuple[FloatArray, ...]
    """Variance of each by the transient's uncertainty, which lines share, shape (lines,) each."""
    degrees: float
    """Degrees of freedom of the noise's estimate."""
    noise_std: float
    """Standard deviation of the noise of one sample, in the unit of the output."""
    smoothness: Smoothness
    """What maximised the evidence."""
    log_evidence: float
    """Its logarithm, up to a constant of the records."""


def lines_of(reference: FloatArray, output: FloatArray, sample_time_s: float) -> Lines:
    """Return the Fourier lines of a record, from its lowest to the Nyquist frequency.

    Differences of the samples are transformed, so that a record that ends elsewhere than it began
    has no transient of its own.

    Args:
        reference: Reference, shape (samples,), in the axis's unit; at least four samples.
        output: Output at the same times, shape (samples,), in the same unit.
        sample_time_s: Time between samples.
    """
    samples = len(reference) - 1
    harmonics = np.arange(1, samples // 2, dtype=np.float64)
    omega = np.asarray(2 * np.pi * harmonics / (samples * sample_time_s))
    step = np.abs(1 - np.exp(-1j * omega * sample_time_s)) ** 2
    return Lines(
        omega_rad_s=omega,
        u=np.fft.rfft(np.diff(reference))[1 : samples // 2],
        y=np.fft.rfft(np.diff(output))[1 : samples // 2],
        noise_gain=samples * step,
        end_gain=2.0,
        scale=float(np.std(output)),
    )


def fit_smooth_loop(
    records: Sequence[Lines],
    omega_max_rad_s: float,
    settling_time_s: float,
    *,
    lead_s: float = 0.0,
) -> SmoothLoop:
    """Fit a smooth loop to all records at once.

    Args:
        records: Fourier lines of each record; together with at least one above `NOISE_ABOVE[0]`
            times the highest frequency.
        omega_max_rad_s: Highest frequency of interest.
        settling_time_s: Time after which a transient of the loop is negligible.
        lead_s: Time by which the output may precede the reference, for records whose clocks differ.
    """
    floor = _power_above(records, omega_max_rad_s)
    inside = [_below(lines, omega_max_rad_s * (1 + TAPS_BANDWIDTH) / 2) for lines in records]
    spacing_s = np.pi / (TAPS_BANDWIDTH * omega_max_rad_s)
    longest_s = max(2 * np.pi / lines.omega_rad_s[0] for lines in inside)
    taps = min(2 + int(min(1.2 * settling_time_s, longest_s) / spacing_s), TAPS_MAX)
    delays_s = np.arange(taps, dtype=np.float64) * spacing_s
    first = _Problem(inside, floor, delays_s, omega_max_rad_s, lead_s)
    at = max(_Ascent(first, start) for start in _STARTS).at
    again = _Problem(inside, floor, delays_s, omega_max_rad_s, lead_s, first.loop(at))
    ascent = _Ascent(again, at)
    return _mean([(weight, again.solution(tried)) for tried, weight in ascent.likely()], ascent)


_STARTS = (Smoothness(), Smoothness(1.0, 24.0, 3.0, 1.0))


class _Ascent:
    """A coordinate ascent of the evidence, and all that it tried."""

    def __init__(self, problem: _Problem, start: Smoothness) -> None:
        self.at, self._tried = start, {start: problem.log_evidence(start)}
        for _ in range(_ASCENTS):
            before = self.at
            for name, choices in _GRID.items():
                for choice in choices:
                    tried = replace(self.at, **{name: choice})
                    if tried not in self._tried:
                        self._tried[tried] = problem.log_evidence(tried)
                self.at = max(self._tried, key=lambda one: self._tried[one])
            if self.at == before:
                break

    @property
    def log_evidence(self) -> float:
        """Logarithm of the largest evidence."""
        return self._tried[self.at]

    def __lt__(self, other: _Ascent) -> bool:
        return self.log_evidence < other.log_evidence

    def likely(self) -> list[tuple[Smoothness, float]]:
        """Return what was tried and is not unlikely, with its share of the evidence."""
        ranked = sorted(self._tried.items(), key=lambda one: -one[1])[:_LIKELY_MAX]
        shares = np.exp([value - self.log_evidence for _, value in ranked])
        return list(zip((at for at, _ in ranked), (shares / shares.sum()).tolist(), strict=True))


def _mean(parts: Sequence[tuple[float, SmoothLoop]], ascent: _Ascent) -> SmoothLoop:
    """Return the mean over all fits; what they disagree on joins the transients' uncertainty."""
    records = range(len(parts[0][1].z))
    z = [sum(w * part.z[n] for w, part in parts) for n in records]
    spread = [
        sum(w * (part.transient[n] + np.abs(part.z[n] - z[n]) ** 2) for w, part in parts)
        for n in records
    ]
    return SmoothLoop(
        z=tuple(np.asarray(one) for one in z),
        noise=tuple(np.asarray(sum(w * part.noise[n] for w, part in parts)) for n in records),
        transient=tuple(np.asarray(one) for one in spread),
        degrees=sum(w * part.degrees for w, part in parts),
        noise_std=math.sqrt(sum(w * part.noise_std**2 for w, part in parts)),
        smoothness=ascent.at,
        log_evidence=ascent.log_evidence,
    )


class _Problem:
    """The linear regression of all lines on the taps of G and of each record's T."""

    def __init__(
        self,
        records: Sequence[Lines],
        floor: float,
        delays_s: FloatArray,
        omega_max_rad_s: float,
        lead_s: float,
        loop: Sequence[ComplexArray] | None = None,
    ) -> None:
        """Build the columns; `loop` is G on the lines of each record, as far as it is known."""
        self._records, self._floor, self._taps = records, floor, len(delays_s)
        self._delays_s, self._omega_max_rad_s = delays_s, omega_max_rad_s
        taps, columns = self._taps, []
        for which, lines in enumerate(records):
            delays = np.exp(-1j * np.outer(lines.omega_rad_s, delays_s))
            early = np.exp(1j * lines.omega_rad_s * lead_s)[:, None]
            block = np.zeros((len(lines.omega_rad_s), taps * (1 + len(records))), np.complex128)
            block[:, :taps] = lines.u[:, None] * early * delays
            own = block[:, taps * (1 + which) : taps * (2 + which)]
            own[:] = delays
            if loop is not None:
                # The first tap keeps the noise of the record's ends, which is white.
                ahead = np.exp(1j * lines.omega_rad_s * TRANSIENT_AHEAD_S / omega_max_rad_s)
                gain = loop[which] / math.sqrt(float(np.mean(np.abs(loop[which]) ** 2)))
                own[:, 1:] = (gain * ahead)[:, None] * delays[:, :-1]
            columns.append(block)
        self._columns = np.concatenate(columns)
        self._y = np.concatenate([lines.y for lines in records])
        self._omega = np.concatenate([lines.omega_rad_s for lines in records])
        self._gain = np.concatenate([lines.noise_gain for lines in records])
        self._grams: dict[float, tuple[FloatArray, FloatArray, float, float]] = {}

    def log_evidence(self, at: Smoothness) -> float:
        """Return the logarithm of the evidence, with the prior of the noise's power."""
        _, half, factor, power = self._posterior(at)
        _, _, square, log_gain = self._gram(at.colour)
        rise = abs(np.log(at.noise_ratio)) * (_NOISE_RATIO_SLOPE if at.noise_ratio >= 1 else 2.0)
        return float(
            0.5 * (half @ half - square / power)
            - np.sum(np.log(np.diag(factor)))
            - log_gain
            - len(self._y) * np.log(power)
            - rise
        )

    def loop(self, at: Smoothness) -> list[ComplexArray]:
        """Return G on the lines of each record."""
        std, half, factor, _ = self._posterior(at)
        weights = (solve_triangular(factor, half, lower=True, trans="T") * std)[: self._taps]
        return [
            np.exp(-1j * np.outer(lines.omega_rad_s, self._delays_s)) @ weights
            for lines in self._records
        ]

    def solution(self, at: Smoothness) -> SmoothLoop:
        """Return the fit at some smoothness."""
        std, half, factor, power = self._posterior(at)
        weights = solve_triangular(factor, half, lower=True, trans="T") * std
        covariance = cho_solve((factor, True), np.eye(len(std))) * np.outer(std, std)
        gram = self._gram(at.colour)[0] / power
        used = float(np.trace(gram @ covariance))
        z, noise, transient, start = [], [], [], 0
        for which, lines in enumerate(self._records):
            rows = slice(start, start + len(lines.omega_rad_s))
            taps = slice(self._taps * (1 + which), self._taps * (2 + which))
            start = rows.stop
            own = self._columns[rows, taps]
            spread = np.einsum("ij,jk,ik->i", own.conj(), covariance[taps, taps], own).real
            strength = np.maximum(np.abs(lines.u) ** 2, np.finfo(float).tiny)
            u = np.where(lines.u == 0, np.sqrt(np.finfo(float).tiny), lines.u)
            z.append((lines.y - own @ weights[taps]) / u)
            noise.append(power * self._shape(at.colour)[rows] / strength)
            transient.append(np.maximum(spread, 0.0) / strength)
        return SmoothLoop(
            z=tuple(z),
            noise=tuple(noise),
            transient=tuple(transient),
            degrees=max(4.0, 2 * len(self._y) - used),
            noise_std=float(np.sqrt(power)),
            smoothness=at,
            log_evidence=self.log_evidence(at),
        )

    def _posterior(self, at: Smoothness) -> tuple[FloatArray, FloatArray, FloatArray, float]:
        """Return prior deviations, L⁻¹Φᵀr, L with LLᵀ = I + ΦᵀΦ, and the noise's power."""
        power = self._floor * at.noise_ratio
        gram, moments, _, _ = self._gram(at.colour)
        std = self._prior_std(at, power)
        told = gram * np.outer(std, std) / power
        # Rounding leaves ΦᵀΦ indefinite by that much, which is more than I without noise.
        rounding = len(std) * np.finfo(float).eps * float(told.diagonal().max())
        told[np.diag_indices_from(told)] += 1.0 + rounding
        factor = cholesky(told, lower=True, check_finite=False)
        half = solve_triangular(factor, moments * std / power, lower=True, check_finite=False)
        return std, half, factor, power

    def _prior_std(self, at: Smoothness, power: float) -> FloatArray:
        decay = np.exp(-self._delays_s * self._omega_max_rad_s / at.memory)
        parts = [at.size * decay / np.linalg.norm(decay)]
        for lines in self._records:
            transient = at.transient * lines.scale * decay
            # The first tap of T also holds the noise of the first and of the last sample.
            transient[0] = np.hypot(transient[0], np.sqrt(lines.end_gain * power))
            parts.append(transient)
        return np.concatenate(parts)

    def _shape(self, colour: float) -> FloatArray:
        rise = np.maximum(1.0, (self._omega_max_rad_s / self._omega) ** colour)
        return np.asarray(self._gain * rise)

    def _gram(self, colour: float) -> tuple[FloatArray, FloatArray, float, float]:
        """Return ΦᵀΦ, Φᵀr, rᵀr and Σ ln of the noise's shape, all for noise of power 1."""
        if colour not in self._grams:
            shape = self._shape(colour)
            # Real and imaginary part have half the power each.
            scale = np.sqrt(2 / shape)
            columns, r = self._columns * scale[:, None], self._y * scale
            self._grams[colour] = (
                np.asarray((columns.conj().T @ columns).real),
                np.asarray((columns.conj().T @ r).real),
                float(np.sum(np.abs(r) ** 2)),
                float(np.sum(np.log(shape))),
            )
        return self._grams[colour]


def _power_above(records: Sequence[Lines], omega_max_rad_s: float) -> float:
    """Return the variance of one sample's noise, by the lines above the reference's band.

    The median of exponentially distributed powers is ln 2 times their mean, and ignores the few
    lines at which the robot still answers.
    """
    low, high = (factor * omega_max_rad_s for factor in NOISE_ABOVE)
    low = min(low, 0.75 * min(float(lines.omega_rad_s[-1]) for lines in records))
    powers = np.concatenate(
        [
            (np.abs(lines.y) ** 2 / (lines.noise_gain + lines.end_gain))[
                (lines.omega_rad_s > low) & (lines.omega_rad_s < high)
            ]
            for lines in records
        ]
    )
    scale = max(lines.scale for lines in records)
    return max(float(np.median(powers)) / math.log(2), (NOISE_MIN * scale) ** 2)


def _below(lines: Lines, omega_rad_s: float) -> Lines:
    inside = lines.omega_rad_s <= omega_rad_s
    return replace(
        lines,
        omega_rad_s=lines.omega_rad_s[inside],
        u=lines.u[inside],
        y=lines.y[inside],
        noise_gain=lines.noise_gain[inside],
    )
