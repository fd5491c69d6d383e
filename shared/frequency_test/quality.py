"""Whether a frequency test can be believed: findings in words, from the samples and their fit."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.strict import Name, Reason, Strict

BoolArray = NDArray[np.bool_]

SETTLED_CHORDAL = 1e-3
UNSETTLED_CHORDAL = 1e-2
"""A change of z during the test is reported above the first and makes it fail above the second,
both as chordal distance, which is what z is used for."""

SETTLED_SIGNIFICANCE = 1e-3
"""Chance that noise alone is reported as a change."""

WINDOWS_MAX = 64
"""In how many windows at most a tone's response is looked at for a change."""

CHANGED_SIGNIFICANCE = 1e-4
"""Chance that white noise is taken for a change in the middle; slow noise is some times as often.
"""

R_SQUARED_REPORTED = 0.9
R_SQUARED_MIN = 0.5

DISTURBED_RATIO = 10.0
DISTURBED_SHARE = 0.1
"""A segment is disturbed when its residual has so many times the power of the other segments' and
this share of the tones' root mean square."""

NO_RESPONSE_SIGNIFICANCE = 1e-3
"""Chance that the noise of a robot that does not move at all is taken for a response."""

SILENCE = 1e-9
"""Tones below this share of the output's largest sample are rounding errors of its offset."""

UNCERTAINTY_MAX_RAD = 0.2
"""A disc of a larger geodesic radius tells no robots apart; π/2 is the whole sphere."""


class Finding(Strict):
    """One thing to know of a test: `code` for programs, `text` for people."""

    code: Name
    text: Reason

    def __str__(self) -> str:
        return self.text


class Quality(Strict):
    """The verdict on a test: with any of `reasons` it has failed; `warnings` qualify a good one."""

    reasons: tuple[Finding, ...] = ()
    warnings: tuple[Finding, ...] = ()

    @property
    def usable(self) -> bool:
        """Whether the estimate may be used as a measurement."""
        return not self.reasons

    def __str__(self) -> str:
        return "; ".join(str(finding) for finding in (*self.reasons, *self.warnings)) or "good"


def unexplained(reference_rms: float, measured: FloatArray, residual: FloatArray) -> Finding | None:
    """Return the finding that the output is not a response to the reference.

    Args:
        reference_rms: root mean square of the reference, in the unit of the output given here.
        measured: the output, shape (samples,).
        residual: what the fit leaves over of it, shape (samples,).

    A small coefficient of determination alone is a matter of noise, which
    the variance carries; together with a residual larger than the reference the robot did something
    else.
    """
    residual_rms = float(np.std(residual))
    total_rms = float(np.std(measured))
    if total_rms == 0.0:
        return None
    r_squared = 1.0 - (residual_rms / total_rms) ** 2
    if r_squared < R_SQUARED_MIN and residual_rms > reference_rms:
        return Finding(
            code="unexplained",
            text=f"the tones explain only {100 * max(0.0, r_squared):.0f} % of the output, and the "
            "rest is larger than the reference: the robot did something else",
        )
    if r_squared < R_SQUARED_REPORTED:
        return Finding(
            code="noisy",
            text=f"the tones explain {100 * max(0.0, r_squared):.0f} % of the output's variance",
        )
    return None


def disturbed(residual: FloatArray, tones: FloatArray, segments: int) -> Finding | None:
    """Return the finding that one segment does not fit, as after a collision or a fall.

    Both of shape (samples,): what the fit leaves over, and the fitted tones.
    """
    # Slow noise moves whole segments; it says nothing of what happened within one.
    power = np.mean(_detrended(residual.reshape(segments, -1)) ** 2, axis=1)
    worst = int(np.argmax(power))
    usual = float(np.median(np.delete(power, worst)))
    share = math.sqrt(float(power[worst]) / (float(np.mean(tones**2)) or math.inf))
    if power[worst] <= DISTURBED_RATIO * usual or share <= DISTURBED_SHARE:
        return None
    return Finding(
        code="disturbed",
        text=f"segment {worst + 1} of {segments} departs from the others by {100 * share:.0f} % of "
        "the response: something disturbed the robot",
    )


def unsettled(segment_z: ComplexArray, omega_rad_s: FloatArray) -> Finding | None:
    """Return the finding that z changes during the test: in the first segment, or steadily.

    Args:
        segment_z: each segment's own estimate, shape (segments, tones).
        omega_rad_s: shape (tones,).
    """
    segments, tones = segment_z.shape
    first = np.zeros(segments)
    first[0] = 1.0
    worst, worst_omega = 0.0, 0.0
    for profile in (first, np.arange(segments, dtype=np.float64)):
        unit = profile - profile.mean()
        unit /= np.linalg.norm(unit)
        change, noise = _projection(segment_z, unit)
        limit = f_quantile(SETTLED_SIGNIFICANCE / (2 * tones), segments - 2)
        # The change between the ends of the profile, scaled to the sphere.
        size = np.sqrt(change) * np.ptp(unit) / (1 + np.abs(segment_z.mean(axis=0)) ** 2)
        size[change <= limit * noise] = 0.0
        if size.max() > worst:
            worst, worst_omega = float(size.max()), float(omega_rad_s[np.argmax(size)])
    if worst <= SETTLED_CHORDAL:
        return None
    return Finding(
        code="unsettled" if worst > UNSETTLED_CHORDAL else "settling",
        text=f"the response at {worst_omega:.4g} rad/s still changes by {worst:.2g} (chordal) "
        "while it is measured: settle longer",
    )


def changed(
    residual: FloatArray, z_scale: FloatArray, omega_rad_s: FloatArray, sample_time_s: float
) -> Finding | None:
    """Return the finding that z became another in the middle of the test, at any moment.

    Half-periods of each tone are demodulated, and each moment is tried as the one at which their
    mean changes. Segments are too few and too long to tell that from noise.

    Args:
        residual: what the fit of the output leaves over, shape (samples,).
        z_scale: what a phasor of 1 in the residual is on the sphere, shape (tones,).
        omega_rad_s: shape (tones,).
        sample_time_s: time between samples.
    """
    worst, worst_omega, worst_at = 0.0, 0.0, 0
    for omega, scale in zip(omega_rad_s.tolist(), z_scale.tolist(), strict=True):
        edges = _half_periods(len(residual), omega * sample_time_s)
        windows = len(edges) - 1
        turned = residual * np.exp(-1j * omega * sample_time_s * np.arange(len(residual)))
        values = 2 * np.add.reduceat(turned, edges[:-1]) / np.diff(edges)
        values -= values.mean()
        before = np.arange(1, windows)
        # With the mean taken out, both sides of a step say the same.
        step = np.abs(np.cumsum(values)[:-1]) * windows / (before * (windows - before))
        explained = step**2 * before * (windows - before) / windows
        total = float(np.sum(np.abs(values) ** 2))
        noise = np.maximum(total - explained, 0.0) / (windows - 2)
        limit = f_quantile(CHANGED_SIGNIFICANCE / (len(omega_rad_s) * len(before)), windows - 2)
        size = np.where(explained > limit * noise, scale * step, 0.0)
        if size.max() > worst:
            worst, worst_omega = float(size.max()), omega
            worst_at = int(edges[1 + np.argmax(size)])
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
    """Yield the findings that the noise hides the response, at some tones or at all.

    Args:
        omega_rad_s: the tones; the rest has the same shape (tones,).
        silent: whether no response stands out of noise and rounding.
        geodesic_rad: radius of the disc that holds z, on the sphere.
    """
    for code, bad, text in (
        ("no-response", silent, "no response stands out of the noise at"),
        ("uncertain", geodesic_rad > UNCERTAINTY_MAX_RAD, "the noise leaves z all but unknown at"),
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
        "clipped",
        "unexplained",
        "disturbed",
        "unsettled",
        "changed",
        "too-many-spikes",
        "distorted",
        "no-response",
        "uncertain",
    }
)


def verdict(findings: list[Finding | None]) -> Quality:
    """Sort findings into reasons to reject a test and warnings about one that stands."""
    found = [finding for finding in findings if finding is not None]
    return Quality(
        reasons=tuple(finding for finding in found if finding.code in FATAL),
        warnings=tuple(finding for finding in found if finding.code not in FATAL),
    )


def f_quantile(alpha: float, pairs: ArrayLike) -> FloatArray:
    """Return the upper α quantile of F with 2 and 2 × `pairs` degrees of freedom."""
    halves = np.asarray(pairs, dtype=np.float64)
    return np.asarray(halves * np.expm1(-math.log(alpha) / halves))


def _half_periods(samples: int, phase_per_sample: float) -> NDArray[np.intp]:
    """Return the edges of windows of whole half-periods, at most `WINDOWS_MAX` of them."""
    half = np.pi / phase_per_sample
    half *= math.ceil(samples / half / WINDOWS_MAX)
    edges = np.round(half * np.arange(math.floor(samples / half) + 1)).astype(np.intp)
    edges[-1] = samples
    return edges


def _detrended(rows: FloatArray) -> FloatArray:
    """Return rows without their least-squares lines; shape (rows, samples)."""
    ramp = np.linspace(-1.0, 1.0, rows.shape[1])
    centred = rows - rows.mean(axis=1, keepdims=True)
    slopes: FloatArray = (centred @ ramp) / (ramp @ ramp)
    straight: FloatArray = centred - slopes[:, None] * ramp
    return straight


def _projection(segment_values: ComplexArray, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the power along a unit profile and the mean power in the rest, mean left out."""
    centred = segment_values - segment_values.mean(axis=0)
    along = np.abs(unit @ centred) ** 2
    total = np.sum(np.abs(centred) ** 2, axis=0)
    return along, np.maximum(total - along, 0.0) / (len(unit) - 2)
