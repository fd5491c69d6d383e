"""The reliability of a frequency test: findings in words, from the samples and their fit."""

from __future__ import annotations

import math
from collections.abc import Iterator
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.strict import Name, Reason, Strict

BoolArray = NDArray[np.bool_]

SETTLED_CHORDAL = 1e-3
UNSETTLED_CHORDAL = 1e-2
"""Limits on a change of z during the test, as chordal distance, since that is how z is used. Above
the first value the change is reported; above the second the test fails."""

SETTLED_SIGNIFICANCE = 1e-3
"""Probability that noise alone is reported as a change."""

WINDOWS_MAX = 64
"""Largest number of windows in which a tone's response is examined for a change."""

CHANGED_WINDOWS_MIN = 6
CHANGED_SIGNIFICANCE = 1e-4
"""Least number of windows in which a change is sought, and the probability that white noise is
taken for one in the middle of a test; for slow noise it is several times higher."""

CHANGED_AFTER = 0.1
"""Least share of the windows that are before a change. In the first of them, z departs from the
others where the robot has not settled."""

R_SQUARED_REPORTED = 0.9
R_SQUARED_MIN = 0.5
"""Coefficients of determination: below the first value the test is reported as noisy; below the
second it fails, provided that the residual is also larger than the reference."""

DISTURBED_RATIO = 10.0
DISTURBED_SHARE = 0.1
"""A segment counts as disturbed if its residual has more than `DISTURBED_RATIO` times the power of
the other segments' residuals, and more than `DISTURBED_SHARE` of the tones' root mean square."""

STOPPED_RATIO = 1.25
"""Motion before the measuring part, as a multiple of the noise in it, that is no noise."""

NO_RESPONSE_SIGNIFICANCE = 1e-3
"""Probability that the noise of a robot that does not move at all is taken for a response."""

SILENCE = 1e-9
"""Tones below this fraction of the output's largest sample are rounding errors of its offset."""

UNCERTAINTY_MAX_RAD = 0.2
"""Largest useful geodesic radius of the disc around z; a larger disc cannot distinguish robots. At
π/2 it covers the whole sphere."""


class Finding(Strict):
    """One observation about the quality of a test."""

    code: Name
    """Kind of finding, for programs."""
    text: Reason
    """The finding in words, for people."""
    value: float | None = None
    """What was found to be how large, for programs: a time in s, or a share of the response."""

    def __str__(self) -> str:
        return self.text


class Quality(Strict):
    """The verdict on a test."""

    reasons: tuple[Finding, ...] = ()
    """Findings that make the test fail; empty for a usable test."""
    warnings: tuple[Finding, ...] = ()
    """Findings that qualify a test without making it fail."""

    @property
    def usable(self) -> bool:
        """True if the estimate may be used as a measurement."""
        return not self.reasons

    def __str__(self) -> str:
        return "; ".join(str(finding) for finding in (*self.reasons, *self.warnings)) or "good"


def unexplained(reference_rms: float, measured: FloatArray, residual: FloatArray) -> Finding | None:
    """Return the finding that the output is not a response to the reference, or is noisy.

    A small coefficient of determination alone is a matter of noise, which the variance accounts
    for. If what moves in the residual is also larger than the reference, the robot did something
    else. Noise of the sensor, which differs from sample to sample, is no motion.

    Args:
        reference_rms: Root mean square of the reference, in the same unit as `measured`.
        measured: Measured output, shape (samples,).
        residual: Output minus the fit, shape (samples,), in the same unit.

    Returns:
        A finding with the code `unexplained` or `noisy`, or None.
    """
    residual_rms = float(np.std(residual))
    total_rms = float(np.std(measured))
    if total_rms == 0.0:
        return None
    r_squared = 1.0 - (residual_rms / total_rms) ** 2
    # The second differences of white noise have six times its variance, those of motion hardly any.
    white = float(np.var(np.diff(residual, 2))) / 6.0
    moved_rms = math.sqrt(max(residual_rms**2 - white, 0.0))
    if r_squared < R_SQUARED_MIN and moved_rms > reference_rms:
        return Finding(
            code="unexplained",
            text=f"the tones explain only {100 * max(0.0, r_squared):.0f} % of the output, and the "
            "rest is larger than the reference: the robot did not follow the test",
        )
    if r_squared < R_SQUARED_REPORTED:
        return Finding(
            code="noisy",
            text=f"the tones explain {100 * max(0.0, r_squared):.0f} % of the output's variance",
        )
    return None


def stopped(before: float, residual: FloatArray) -> Finding | None:
    """Return the finding that a robot moved while it settled, and not while it was measured.

    Args:
        before: Deviation of what no decay explains before the measuring part.
        residual: Output minus the fit in the measuring part, shape (samples,), in the same unit.
    """
    if before <= STOPPED_RATIO * float(np.std(_detrended(residual[None]))):
        return None
    return Finding(
        code="stopped",
        text="the robot moved before it was measured, and responds to no tone from then on: it "
        "stopped following its reference",
    )


def disturbed(residual: FloatArray, tones: FloatArray, segments: int) -> Finding | None:
    """Return the finding that one segment does not fit, for example after a collision or a fall.

    Args:
        residual: Output minus the usual response to the tones, shape (samples,).
        tones: Fitted tones of the output, shape (samples,), in the same unit.
        segments: Number of segments of equal length.

    Returns:
        A finding with the code `disturbed`, or None.
    """
    # Slow noise shifts and tilts whole segments, which is no sign of an event within one.
    power = np.mean(_detrended(residual.reshape(segments, -1)) ** 2, axis=1)
    worst = int(np.argmax(power))
    usual = middle_of(np.delete(power, worst))
    share = math.sqrt(float(power[worst]) / (float(np.mean(tones**2)) or math.inf))
    if power[worst] <= DISTURBED_RATIO * usual or share <= DISTURBED_SHARE:
        return None
    return Finding(
        code="disturbed",
        text=f"segment {worst + 1} of {segments} differs from the others by {100 * share:.0f} % of "
        "the response: something disturbed the robot",
    )


def unsettled(segment_z: ComplexArray, omega_rad_s: FloatArray) -> Finding | None:
    """Return the finding that z changes during the test: in the first segment, or steadily.

    The estimates of the segments are projected onto both profiles of change. A projection counts if
    its power exceeds the mean power of the rest by more than the quantile of the F distribution.

    Args:
        segment_z: Estimate of z from each segment, shape (segments, tones).
        omega_rad_s: Frequencies of the tones, shape (tones,).

    Returns:
        A finding with the code `unsettled` (fails the test) or `settling` (a warning), or None.
    """
    segments, tones = segment_z.shape
    units, ranges = _changes(segments)
    change, noise = _projections(segment_z, units)
    limit = f_quantile(SETTLED_SIGNIFICANCE / (2 * tones), segments - 2)
    # The change between the extremes of a profile, as a chordal distance: |dz| / (1 + |z|²).
    size = np.sqrt(change) * ranges[:, None] / (1 + np.abs(segment_z.mean(axis=0)) ** 2)
    size[change <= limit * noise] = 0.0
    worst, worst_omega = float(size.max()), float(omega_rad_s[np.argmax(size) % tones])
    if worst <= SETTLED_CHORDAL:
        return None
    return Finding(
        code="unsettled" if worst > UNSETTLED_CHORDAL else "settling",
        text=f"the response at {worst_omega:.4g} rad/s still changes by {worst:.2g} (chordal) "
        "while it is measured: allow more time to settle",
    )


def changed(
    residual: FloatArray, z_scale: FloatArray, omega_rad_s: FloatArray, sample_time_s: float
) -> Finding | None:
    """Return the finding that z changed abruptly at some moment in the middle of the test.

    Half-periods of each tone are demodulated, and every boundary between them is tried as the
    moment at which their mean changes. Segments would be too few and too long to distinguish such a
    change from noise. Distortion that falls next to a tone, on both sides of it, turns once per
    test, and looks like a step, too, but explains more than any step.

    Args:
        residual: Output minus the fit, shape (samples,).
        z_scale: Chordal distance that corresponds to a phasor of 1 in the residual, shape (tones,).
        omega_rad_s: Frequencies of the tones, shape (tones,).
        sample_time_s: Time between samples.

    Returns:
        A finding with the code `changed`, or None.
    """
    worst, worst_omega, worst_at = 0.0, 0.0, 0
    for omega, scale in zip(omega_rad_s.tolist(), z_scale.tolist(), strict=True):
        edges = _half_periods(len(residual), omega * sample_time_s)
        windows = len(edges) - 1
        if windows < CHANGED_WINDOWS_MIN:
            continue
        turned = residual * np.exp(-1j * omega * sample_time_s * np.arange(len(residual)))
        # The phasor of the residual in each window: twice the mean of r(t) e^{−jωt}.
        values = 2 * np.add.reduceat(turned, edges[:-1]) / np.diff(edges)
        values -= values.mean()
        before = np.arange(1 + int(CHANGED_AFTER * windows), windows)
        # Without the mean, the sums before and after a step are opposite, so one of them suffices:
        # S/n₁ + S/n₂ is the difference of the two means.
        step = np.abs(np.cumsum(values)[before - 1]) * windows / (before * (windows - before))
        explained = step**2 * before * (windows - before) / windows
        total = float(np.sum(np.abs(values) ** 2))
        noise = np.maximum(total - explained, 0.0) / (windows - 2)
        # Bonferroni: the significance is shared out among all tones and moments tried.
        limit = f_quantile(CHANGED_SIGNIFICANCE / (len(omega_rad_s) * len(before)), windows - 2)
        beside = np.exp(2j * np.pi * np.outer((-1, 1), np.arange(windows) / windows)) @ values
        turning = float(np.sum(np.abs(beside) ** 2)) / windows
        size = np.where(explained > np.maximum(limit * noise, turning), scale * step, 0.0)
        if size.max() > worst:
            worst, worst_omega = float(size.max()), omega
            worst_at = int(edges[before[np.argmax(size)]])
    if worst <= UNSETTLED_CHORDAL:
        return None
    return Finding(
        code="changed",
        text=f"the response at {worst_omega:.4g} rad/s changed by {worst:.2g} (chordal) "
        f"{worst_at * sample_time_s:.3g} s into the measuring part: repeat the test",
    )


def uncertain(
    omega_rad_s: FloatArray, silent: BoolArray, geodesic_rad: FloatArray
) -> Iterator[Finding]:
    """Yield the findings that noise hides the response, at some tones or at all of them.

    Args:
        omega_rad_s: Frequencies of the tones, shape (tones,).
        silent: True for tones whose response is hidden by noise and rounding, shape (tones,).
        geodesic_rad: Radius of the disc around z, as an angle on the sphere, shape (tones,).
    """
    for code, bad, text in (
        ("no-response", silent, "no response exceeds the noise at"),
        ("uncertain", geodesic_rad > UNCERTAINTY_MAX_RAD, "the noise leaves z nearly unknown at"),
    ):
        if bad.any():
            where = ", ".join(f"{omega:.4g}" for omega in omega_rad_s[bad][:8])
            more = f" and {bad.sum() - 8} more" if bad.sum() > 8 else ""
            yield Finding(
                code=code if bad.all() else f"{code}-at-some", text=f"{text} {where}{more} rad/s"
            )


FATAL = frozenset(
    {
        "frozen",
        "stopped",
        "clipped",
        "unexplained",
        "disturbed",
        "unsettled",
        "changed",
        "too-many-spikes",
        "uncertain",
    }
)


def verdict(findings: list[Finding | None]) -> Quality:
    """Sort findings into reasons to reject a test and warnings about a usable one.

    Args:
        findings: Findings in the order to be reported; None entries are dropped.
    """
    found = [finding for finding in findings if finding is not None]
    return Quality(
        reasons=tuple(finding for finding in found if finding.code in FATAL),
        warnings=tuple(finding for finding in found if finding.code not in FATAL),
    )


def f_quantile(alpha: float, pairs: ArrayLike) -> FloatArray:
    """Return the upper α quantile of the F distribution with 2 and 2 × `pairs` degrees of freedom.

    With two degrees in the numerator it has the closed form d (α^(−1/d) − 1), where d = `pairs`.

    Args:
        alpha: Probability that the quantile is exceeded.
        pairs: Half the degrees of freedom of the denominator, any shape.

    Returns:
        Quantiles of the same shape.
    """
    halves = np.asarray(pairs, dtype=np.float64)
    return np.asarray(halves * np.expm1(-math.log(alpha) / halves))


def uncertainty_radius(
    variance: FloatArray, degrees: FloatArray, alpha: float = 0.05
) -> FloatArray:
    """Return the radius ρ of each estimate's confidence disc.

    ρ² = s² F, where F is the 1 − α quantile of the F distribution with 2 and `degrees` degrees of
    freedom (real and imaginary part have half the variance each).

    Args:
        variance: Variance s² of each estimate, any shape.
        degrees: Degrees of freedom of each variance, the same shape.
        alpha: Probability α that a disc misses z.

    Returns:
        Radii in the complex plane, the same shape.
    """
    return np.sqrt(variance * f_quantile(alpha, degrees / 2))


def middle_of(values: NDArray[Any]) -> float:
    """Return the median; `numpy.median` takes four times as long for a thousand values.

    Args:
        values: Finite numbers, shape (n,), at least one.
    """
    low, high = (len(values) - 1) // 2, len(values) // 2
    ordered = np.partition(values, (low, high))
    return float(ordered[low] + ordered[high]) / 2


def _half_periods(samples: int, phase_per_sample: float) -> NDArray[np.intp]:
    """Return the edges of at most `WINDOWS_MAX` windows of whole half-periods, (windows + 1,).

    The edges are indices of samples; the last window takes the remainder.
    """
    half = np.pi / phase_per_sample
    half *= math.ceil(samples / half / WINDOWS_MAX)
    edges = np.round(half * np.arange(math.floor(samples / half) + 1)).astype(np.intp)
    edges[-1] = samples
    return edges


def _detrended(rows: FloatArray) -> FloatArray:
    """Return each row minus its least-squares line, shape (rows, samples)."""
    ramp = np.linspace(-1.0, 1.0, rows.shape[1])
    centred = rows - rows.mean(axis=1, keepdims=True)
    slopes: FloatArray = (centred @ ramp) / (ramp @ ramp)
    straight: FloatArray = centred - slopes[:, None] * ramp
    return straight


@lru_cache(8)
def _changes(segments: int) -> tuple[FloatArray, FloatArray]:
    """Return the profiles of a change in the first segment and of a steady one, and their ranges.

    The profiles have shape (2, segments), mean 0 and norm 1; the ranges have shape (2,).
    """
    profiles = np.stack([np.arange(segments) == 0, np.arange(segments)]).astype(np.float64)
    profiles -= profiles.mean(axis=1, keepdims=True)
    profiles /= np.linalg.norm(profiles, axis=1, keepdims=True)
    return profiles, np.ptp(profiles, axis=1)


def _projections(segment_values: ComplexArray, units: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the power along each unit profile, and the mean power per remaining degree of freedom.

    `segment_values` has shape (segments, n), its mean over segments is removed first; `units` has
    shape (profiles, segments), both results have shape (profiles, n).
    """
    centred = segment_values - segment_values.mean(axis=0)
    along = np.abs(units @ centred) ** 2
    total = np.sum(np.abs(centred) ** 2, axis=0)
    return along, np.maximum(total - along, 0.0) / (units.shape[1] - 2)
