"""Whether a frequency test can be believed: findings in words, from the samples and their fit."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from shared.arrays import ComplexArray, FloatArray
from shared.sinusoid_fit import SinusoidFit
from shared.strict import Name, Reason, Strict

RUN_MIN_SAMPLES = 10
"""Shorter runs of identical samples are a matter of resolution, not a fault."""

RUN_MOTION_MIN = 0.02
"""A run is a fault when the output should have moved by this share of its range meanwhile."""

SETTLED_CHORDAL = 1e-3
UNSETTLED_CHORDAL = 1e-2
"""A change of z during the test is reported above the first and makes it fail above the second,
both as chordal distance, which is what z is used for."""

SETTLED_SIGNIFICANCE = 1e-3
HARMONIC_SIGNIFICANCE = 1e-3
HARMONIC_SCATTER_SIGNIFICANCE = 1e-2
"""Chances of a false report in noise: of a change, of a harmonic against white noise, and of one
against the scatter between segments."""

DISTORTION_REPORTED = 0.01
DISTORTION_MAX = 0.25
"""Amplitude of all harmonics relative to all tones: reported above the first, failed above the
second, where one complex number does not describe the response any more."""

R_SQUARED_REPORTED = 0.9
R_SQUARED_MIN = 0.5

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


def sensor_faults(measured: FloatArray, tones: FloatArray) -> Iterator[Finding]:
    """Yield what runs of identical samples say of the sensor.

    Args:
        measured: the output, shape (samples,).
        tones: the fitted tones alone, shape (samples,): how the output should have moved.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(measured)) + 1])
    lengths = np.diff(np.concatenate([starts, [len(measured)]]))
    if len(starts) == 1:
        yield Finding(
            code="frozen", text=f"the output stays at exactly {measured[0]:.6g} throughout"
        )
        return
    # A coarse or slow sensor repeats itself too, but never by more than its resolution or rate.
    levels = np.unique(measured)
    resolution = float(np.min(np.diff(levels)))
    motion_min = max(2 * resolution, RUN_MOTION_MIN * float(np.ptp(tones)))
    length_min = RUN_MIN_SAMPLES * max(1.0, float(np.median(lengths)))
    stuck = [
        (int(start), int(length))
        for start, length in zip(starts, lengths, strict=True)
        if length >= length_min and np.ptp(tones[start : start + length]) > motion_min
    ]
    extremes = {float(levels[0]), float(levels[-1])}
    clipped = [start for start, _ in stuck if float(measured[start]) in extremes]
    if len(clipped) > 1:
        bounds = sorted({float(measured[start]) for start in clipped})
        yield Finding(
            code="clipped",
            text=f"the output is cut off at {' and '.join(f'{b:.6g}' for b in bounds)} "
            f"({len(clipped)} times): a sensor or actuator saturates",
        )
    elif stuck:
        start, length = max(stuck, key=lambda run: run[1])
        yield Finding(
            code="frozen",
            text=f"the output stays at exactly {measured[start]:.6g} for {length} samples while "
            "the reference moves",
        )


def unexplained(reference_rms: float, measured: FloatArray, fitted: FloatArray) -> Finding | None:
    """Return the finding that the output is not a response to the reference.

    Args:
        reference_rms: root mean square of the reference, in the unit of the output given here.
        measured: the output, shape (samples,).
        fitted: all that was fitted to it, shape (samples,).

    A small coefficient of determination alone is a matter of noise, which
    the variance carries; together with a residual larger than the reference the robot did something
    else.
    """
    residual_rms = float(np.std(measured - fitted))
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


def distortion(fit: SinusoidFit, tones: int, measured: FloatArray) -> Finding | None:
    """Return the finding that the response is not linear at this amplitude.

    Args:
        fit: the fit of the output; tones first, then harmonics.
        tones: how many of its frequencies are tones.
        measured: the output, shape (samples,).
    """
    power = np.abs(fit.phasors) ** 2
    white = 4 * np.var(measured - fit.fitted) / len(measured)
    significant = (power > white * math.log(1 / HARMONIC_SIGNIFICANCE)) & (
        power
        > fit.variance * f_quantile(HARMONIC_SCATTER_SIGNIFICANCE, len(fit.segment_phasors) - 1)
    )
    harmonic_power = np.where(significant, power, 0.0)[tones:]
    linear_power = float(np.sum(power[:tones]))
    if linear_power == 0.0 or not harmonic_power.any():
        return None
    ratio = math.sqrt(float(np.sum(harmonic_power)) / linear_power)
    if ratio <= DISTORTION_REPORTED:
        return None
    strongest = float(fit.omega_rad_s[tones + int(np.argmax(harmonic_power))])
    return Finding(
        code="distorted" if ratio > DISTORTION_MAX else "nonlinear",
        text=f"the response is not linear at this amplitude: harmonics of {100 * ratio:.2g} %, "
        f"the strongest at {strongest:.4g} rad/s; repeat at half the amplitude",
    )


def uncertain(
    omega_rad_s: FloatArray, gain: FloatArray, radius: FloatArray, geodesic_rad: FloatArray
) -> Iterator[Finding]:
    """Yield the findings that the noise hides the response, at some tones or at all.

    Args:
        omega_rad_s: the tones; the rest has the same shape (tones,).
        gain: |z|.
        radius: radius of the disc that holds z.
        geodesic_rad: the same on the sphere.
    """
    for code, bad, text in (
        ("no-response", gain <= radius, "no response stands out of the noise at"),
        ("uncertain", geodesic_rad > UNCERTAINTY_MAX_RAD, "the noise leaves z all but unknown at"),
    ):
        if bad.any():
            where = ", ".join(f"{omega:.4g}" for omega in omega_rad_s[bad][:8])
            more = f" and {bad.sum() - 8} more" if bad.sum() > 8 else ""
            yield Finding(
                code=code if bad.all() else f"{code}-at-some", text=f"{text} {where}{more} rad/s"
            )


FATAL = frozenset(
    {"frozen", "clipped", "unexplained", "unsettled", "distorted", "no-response", "uncertain"}
)


def verdict(findings: list[Finding | None]) -> Quality:
    """Sort findings into reasons to reject a test and warnings about one that stands."""
    found = [finding for finding in findings if finding is not None]
    return Quality(
        reasons=tuple(finding for finding in found if finding.code in FATAL),
        warnings=tuple(finding for finding in found if finding.code not in FATAL),
    )


def f_quantile(alpha: float, pairs: int) -> float:
    """Return the upper α quantile of F with 2 and 2 × `pairs` degrees of freedom."""
    return pairs * math.expm1(-math.log(alpha) / pairs)


def _projection(segment_values: ComplexArray, unit: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the power along a unit profile and the mean power in the rest, mean left out."""
    centred = segment_values - segment_values.mean(axis=0)
    along = np.abs(unit @ centred) ** 2
    total = np.sum(np.abs(centred) ** 2, axis=0)
    return along, np.maximum(total - along, 0.0) / (len(unit) - 2)
