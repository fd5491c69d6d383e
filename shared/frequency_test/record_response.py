"""The response of a closed loop from records of any reference, where the reference has power.

A frequency test plays tones and knows what noise is by what lies between them. A flight along a
drawing, or in a log, has power at all frequencies, more or less of it: each Fourier line
is an estimate of its own, neighbouring lines are averaged, and lines at which the noise hides the
response say nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import geodesic_radius
from nufleet.shared.frequency_test.frequency_response import Flight, FrequencyResponse
from nufleet.shared.frequency_test.quality import UNCERTAINTY_MAX_RAD, Finding, Quality
from nufleet.shared.frequency_test.smooth_loop import (
    Lines,
    SmoothLoop,
    fit_smooth_loop,
    lines_of,
)

BIN_MAX_RAD_S = 0.15
BIN_DECAYS = 0.3
"""Width of the bins whose lines are averaged, at most, and in decay rates of the slowest mode: over
0.3 of them a resonance bends by less than 1 % of its height."""

DECAYS_UNTIL_SETTLED = 7.0
"""Number of time constants after which a transient, then at 1e-3, counts as settled."""

SETTLED_SHARE = 0.8
"""Least duration of the longest stretch, as a share of the settling time."""

STRETCHES_MAX = 8
"""Largest number of stretches that are estimated together; the longest are taken."""

LINES_MIN = 3
"""Least number of lines in the band of a stretch."""

LEADS = (1.5, 4.0)
LEAD_LOG_EVIDENCE = (12.0, 0.2)
"""Leads of the output over the reference that are tried, times the highest frequency, and the gain
in log evidence, and more for each line, from which one of them is believed."""

SPEED_S = 0.2
"""Time over which the speed of a reference is taken, which steps between samples do not show."""

DRIFT_SHARE = 0.2
DRIFT_LEFT = 0.7
"""Drift, as a share of the output's standard deviation, from which it is reported, and the share of
what it must leave, at most, of the rest of the output."""

UNEXPLAINED_SHARE = 0.7
"""Share of an output that may be noise, as a standard deviation."""

FATAL = frozenset({"non-causal", "no-excitation", "unexplained", "too-short"})

SEGMENTS = 3
"""Number of segments of a test, which the record of a response cannot do without."""


@dataclass(frozen=True, eq=False)
class Stretch:
    """A part of a record without gaps."""

    reference: FloatArray
    """Reference at each sample, shape (samples,), in the axis's unit."""
    output: FloatArray
    """Output measured at the same times, shape (samples,), in the same unit."""


@dataclass(frozen=True)
class RecordResponse:
    """A response with the circumstances in which it was measured."""

    response: FrequencyResponse
    """Estimates of z, and the verdict on them."""
    band_rad_s: tuple[float, float] | None
    """Lowest and highest frequency at which something is claimed; None where nothing is."""
    duration_s: float
    """Duration of what was used."""


def estimate_record_response(
    stretches: Sequence[Stretch],
    sample_time_s: float,
    band_rad_s: tuple[float, float],
    settling_time_s: float,
    *,
    delay_std_s: float = 0.0,
) -> RecordResponse:
    """Estimate z(ω) = Y/R of one axis within a band.

    Faults in the samples lead to a verdict, never to an exception.

    Args:
        stretches: Parts of the record, in any order.
        sample_time_s: Time between samples.
        band_rad_s: Lowest and highest frequency to estimate, below a sixth of the sampling rate.
        settling_time_s: Time after which a transient of the loop is negligible.
        delay_std_s: Standard deviation of an unknown constant delay between the clocks of reference
            and output; it turns the phase and widens the estimates by ω |z| times itself.

    Returns:
        The response at the frequencies where the reference has power, in no more and no less; it is
        not usable where there is none, or where the output precedes the reference.
    """
    low, high = band_rad_s
    usable = [
        one
        for one in stretches
        if np.all(np.isfinite(one.reference)) and np.all(np.isfinite(one.output))
    ]
    usable = sorted(usable, key=lambda one: -len(one.reference))[:STRETCHES_MAX]
    records = [
        (one, lines_of(one.reference, one.output, sample_time_s))
        for one in usable
        if len(one.reference) * sample_time_s * (high - low) >= 2 * math.pi * LINES_MIN
        and np.ptp(one.reference) > 0
        and np.ptp(one.output) > 0
    ]
    if not records:
        needed_s = 2 * math.pi * LINES_MIN / (high - low)
        longest_s = sample_time_s * max((len(one.reference) for one in stretches), default=0)
        return _nothing(
            "no-excitation",
            f"no part of it, of at most {longest_s:.3g} s, lasts {needed_s:.3g} s without a gap "
            "while reference and output move",
        )
    used = [one for one, _ in records]
    longest_s = max(len(one.reference) for one in used) * sample_time_s
    if longest_s < SETTLED_SHARE * settling_time_s:
        return _nothing(
            "too-short",
            f"its longest part lasts {longest_s:.3g} s, and the robot settles in "
            f"{settling_time_s:.3g} s: what it did before cannot be told from its response; at "
            f"least {SETTLED_SHARE * settling_time_s:.3g} s are needed",
        )
    fit = fit_smooth_loop([lines for _, lines in records], high, settling_time_s)
    findings = list(_findings(records, fit, high, settling_time_s))
    found = _averaged([lines for _, lines in records], fit, band_rad_s, settling_time_s)
    variance = found.variance + (found.omega_rad_s * delay_std_s * np.abs(found.z)) ** 2
    radius = np.sqrt(variance)
    # The quotient of two noises is near ∞, and certain of it on the sphere: so not only there.
    known = radius <= UNCERTAINTY_MAX_RAD * np.maximum(1.0, np.abs(found.z))
    known &= geodesic_radius(found.z, radius) <= UNCERTAINTY_MAX_RAD
    if not known.any():
        findings.append(
            Finding(
                code="no-excitation",
                text=f"the reference has no power between {low:g} and {high:g} rad/s that stands "
                f"out of the noise of {fit.noise_std:.2g} per sample: nothing is claimed",
            )
        )
    reasons = tuple(one for one in findings if one.code in FATAL)
    omega = found.omega_rad_s[known]
    return RecordResponse(
        response=FrequencyResponse(
            omega_rad_s=omega,
            z=found.z[known],
            variance=variance[known],
            segments=SEGMENTS,
            quality=Quality(
                reasons=reasons, warnings=tuple(one for one in findings if one not in reasons)
            ),
            degrees=np.full(len(omega), fit.degrees),
            amplitude=max(float(np.ptp(one.reference)) / 2 for one in used),
            flight=Flight(
                speed=max(_speed(one.reference, sample_time_s) for one in used),
                noise_std=fit.noise_std,
            ),
        ),
        band_rad_s=(float(omega[0]), float(omega[-1])) if known.any() else None,
        duration_s=sum(len(one.reference) for one in used) * sample_time_s,
    )


@dataclass(frozen=True, eq=False)
class _Averaged:
    omega_rad_s: FloatArray
    z: ComplexArray
    variance: FloatArray


def _averaged(
    records: Sequence[Lines],
    fit: SmoothLoop,
    band_rad_s: tuple[float, float],
    settling_time_s: float,
) -> _Averaged:
    """Average the lines of each bin, weighted by the reference's power over the noise's.

    At the weighted mean of the lines' frequencies a straight piece of z is met without a bias.
    """
    low, high = band_rad_s
    count = [len(z) for z in fit.z]
    omega = np.concatenate([lines.omega_rad_s[:n] for lines, n in zip(records, count, strict=True)])
    inside = (omega >= low) & (omega <= high)
    omega, z = omega[inside], np.concatenate(fit.z)[inside]
    noise, transient = np.concatenate(fit.noise)[inside], np.concatenate(fit.transient)[inside]
    width = BIN_MAX_RAD_S
    if settling_time_s > 0:
        width = min(width, BIN_DECAYS * DECAYS_UNTIL_SETTLED / settling_time_s)
    _, place = np.unique(np.floor(omega / width).astype(np.int64), return_inverse=True)
    bins = int(place.max()) + 1
    weight = 1 / (noise + transient)
    total = np.bincount(place, weight, bins)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.bincount(place, weight * values, bins) / total)

    # Noise differs from line to line; all lines share the error of the transients.
    independent = np.bincount(place, weight**2 * noise, bins) / total**2
    together = np.square(mean(np.asarray(np.sqrt(transient))))
    return _Averaged(mean(omega), mean(z.real) + 1j * mean(z.imag), independent + together)


def _findings(
    records: Sequence[tuple[Stretch, Lines]],
    fit: SmoothLoop,
    omega_max_rad_s: float,
    settling_time_s: float,
) -> list[Finding]:
    found: list[Finding] = []
    lines = [own for _, own in records]
    gains = {
        lead / omega_max_rad_s: fit_smooth_loop(
            lines, omega_max_rad_s, settling_time_s, lead_s=lead / omega_max_rad_s
        ).log_evidence
        - fit.log_evidence
        for lead in LEADS
    }
    lead_s = max(gains, key=lambda lead: gains[lead])
    least, per_line = LEAD_LOG_EVIDENCE
    if gains[lead_s] > least + per_line * sum(len(z) for z in fit.z):
        found.append(
            Finding(
                code="non-causal",
                text=f"the output moves before its reference, by about {lead_s:.2g} s: the two are "
                "exchanged, their clocks differ, or the reference is not what the robot was sent",
            )
        )
    drift = max(records, key=lambda one: abs(_drift(one[0])))[0]
    if abs(_drift(drift)) > DRIFT_SHARE * float(np.std(drift.output)):
        found.append(
            Finding(
                code="drift",
                text=f"the output moves by {_drift(drift):.2g} against its reference from the "
                "beginning to the end: it drifts",
            )
        )
    residual = fit.noise_std / max(one.scale for one in lines)
    if residual > UNEXPLAINED_SHARE:
        found.append(
            Finding(
                code="unexplained",
                text=f"what the reference does not explain of the output is {100 * residual:.0f} % "
                "of it: these are not the reference and the output of one loop",
            )
        )
    return found


def _drift(one: Stretch) -> float:
    """Return how far the output moves steadily from beginning to end, in the axis's unit.

    Gain, lag and inertia of the loop are fitted along with it; the result is 0 unless the drift
    explains most of what they leave.
    """
    samples = len(one.output)
    speed = np.gradient(one.reference)
    loop = np.stack([one.reference, speed, np.gradient(speed), np.ones(samples)], axis=1)
    both = np.concatenate([loop, np.linspace(-0.5, 0.5, samples)[:, None]], axis=1)
    without, drifting = (np.linalg.lstsq(columns, one.output)[0] for columns in (loop, both))
    left = np.std(one.output - loop @ without), np.std(one.output - both @ drifting)
    return float(drifting[-1]) if left[1] < DRIFT_LEFT * left[0] else 0.0


def _speed(reference: FloatArray, sample_time_s: float) -> float:
    step = max(1, round(SPEED_S / sample_time_s))
    if len(reference) <= step:
        return 0.0
    return float(np.max(np.abs(reference[step:] - reference[:-step]))) / (step * sample_time_s)


def _nothing(code: str, text: str) -> RecordResponse:
    none = np.empty(0)
    return RecordResponse(
        response=FrequencyResponse(
            omega_rad_s=none,
            z=none.astype(np.complex128),
            variance=none,
            segments=SEGMENTS,
            quality=Quality(reasons=(Finding(code=code, text=text),)),
            degrees=none,
        ),
        band_rad_s=None,
        duration_s=0.0,
    )
