"""The response z(ω) of a robot from one frequency test, with its uncertainty and a verdict.

z(ω) = A(ω) e^{jθ(ω)} is the paper's eq. (5): amplitude gain A and phase shift θ from reference to
output.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import geodesic_radius
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.mid_test_change import changed_midway
from nufleet.shared.frequency_test.nonlinearity import (
    harmonic_distortion,
    intermodulation,
    nonlinear,
    power_distortion,
)
from nufleet.shared.frequency_test.quality import (
    NO_RESPONSE_SIGNIFICANCE,
    SILENCE,
    Finding,
    Quality,
    changed,
    disturbed,
    f_quantile,
    stopped,
    uncertain,
    unexplained,
    unsettled,
    verdict,
)
from nufleet.shared.frequency_test.ring_down import RingDown, ring_down, still_ringing
from nufleet.shared.frequency_test.sensor_faults import sensor_faults
from nufleet.shared.frequency_test.sinusoid_fit import (
    SinusoidFit,
    UnresolvableError,
    complex_median,
    fit_sinusoids,
    resolvable_harmonics,
    sum_of_tones,
    variance_of_mean,
)
from nufleet.shared.frequency_test.suspect_samples import Tested, suspicions

GAIN_MAX = 1e12
"""An output larger than this multiple of the reference is not a response to it."""

REFERENCE_TONE_MIN = 1e-9
"""A tone below this fraction of the reference's largest sample counts as missing from it."""


@dataclass(frozen=True)
class Flight:
    """The motion that a response was measured in, where no test measured it."""

    speed: float
    """Largest speed of the reference, in the axis's unit per second."""
    noise_std: float
    """Standard deviation of the noise of one sample of the output, in the axis's unit."""


@dataclass(frozen=True)
class FrequencyResponse:
    """Estimates ẑ of z(ω) = Y/U at the tones of one test, in the order of its plan.

    If nothing could be estimated, ẑ is NaN, its variance infinite, and the test not usable.
    """

    omega_rad_s: FloatArray
    """Frequencies of the tones, shape (tones,)."""
    z: ComplexArray
    """Estimates ẑ, output over reference in the same unit, shape (tones,)."""
    variance: FloatArray
    """E|ẑ − z|² of each estimate, shape (tones,), for a circular error: the scatter between
    segments, plus the contribution that suspicious samples may have made."""
    segments: int
    """Number P of segments that the variance was estimated from."""
    quality: Quality
    """Verdict on the test."""
    degrees: FloatArray | None = None
    """Degrees of freedom of each variance, shape (tones,). None means 2P − 2, which holds for tones
    that each segment alone can separate."""
    amplitude: float | None = None
    """Peak of the reference in the axis's unit; None if unknown."""
    flight: Flight | None = None
    """The flight that measured it; None for a test."""

    @property
    def degrees_of_freedom(self) -> FloatArray:
        """Degrees of freedom of each variance, shape (tones,)."""
        if self.degrees is not None:
            return self.degrees
        return np.full(len(self.omega_rad_s), 2.0 * (self.segments - 1))

    def radius(self, alpha: float = 0.05) -> FloatArray:
        """Return the radius ρ of the disc around each ẑ that holds z with probability 1 − α.

        Args:
            alpha: Probability α that a disc misses z.

        Returns:
            Radii in the complex plane, shape (tones,).
        """
        return uncertainty_radius(self.variance, self.degrees_of_freedom, alpha)


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


def estimate_frequency_response(
    reference: FloatArray, response: FloatArray, plan: ExcitationPlan
) -> FrequencyResponse:
    """Estimate z at every tone of a test from the samples of its measuring part.

    All tones, an offset, a drift and second and third harmonics are fitted jointly to the whole
    measuring part; the variance comes from the contributions of the single segments. (The mean of
    phasors fitted to each segment alone has up to 2.8 times the variance: within one period a drift
    looks like a sine.) Faults in the samples lead to a verdict, never to an exception.

    Args:
        reference: Reference of the tested axis, shape (samples,), in the axis's unit.
        response: Output measured at the same times, shape (samples,), in the axis's unit.
        plan: Excitation that the robot played.
    """
    omegas = np.array([tone.omega_rad_s for tone in plan.tones])
    first = plan.first_measured_sample
    end = first + plan.segments * plan.segment_samples
    if min(len(reference), len(response)) < end:
        text = f"the test ended early: {len(response)} samples, but measuring ends at sample {end}"
        return _failed(omegas, plan, "ended-early", text)
    u, y = reference[first:end], response[first:end]
    for name, signal in (("reference", u), ("output", y)):
        bad = np.flatnonzero(~np.isfinite(signal))
        if len(bad):
            text = f"the {name} contains {len(bad)} samples that are not finite"
            return _failed(omegas, plan, "not-finite", text)
    # Scaled to 1, so that no square overflows, however far the robot has moved.
    u_scale, y_scale = float(np.max(np.abs(u))), float(np.max(np.abs(y)))
    if u_scale == 0.0:
        return _failed(omegas, plan, "no-reference", "the reference is zero throughout")
    if y_scale > GAIN_MAX * u_scale:
        text = f"the output reaches {y_scale:.2g} with a reference of {u_scale:.2g}: it ran away"
        return _failed(omegas, plan, "unexplained", text)
    begin = plan.ramp_samples
    before = np.stack([reference[begin:first], response[begin:first]])
    if not np.all(np.isfinite(before)) or np.max(np.abs(before), initial=0.0) > GAIN_MAX * u_scale:
        begin = first
    settled = _Samples(
        reference[begin:end] / u_scale, response[begin:end] / (y_scale or 1.0), u_scale, y_scale
    )
    return _estimate(settled, first - begin, omegas, plan)


@dataclass(frozen=True)
class _Samples:
    """A part of a test, scaled so that the largest measured sample of each signal is 1."""

    u: FloatArray
    """Scaled reference, shape (samples,)."""
    y: FloatArray
    """Scaled output, shape (samples,)."""
    u_scale: float
    """Largest magnitude of the reference, in the axis's unit."""
    y_scale: float
    """Largest magnitude of the output, in the axis's unit."""


@dataclass(frozen=True)
class _Estimates:
    """The estimates of z from single segments, and the variance of their mean."""

    segment_z: ComplexArray
    """Estimate of z from each segment, shape (segments, tones)."""
    variance: FloatArray
    """Variance of their mean, shape (tones,)."""
    degrees: FloatArray
    """Degrees of freedom of that variance, shape (tones,)."""


def _estimate(
    between: _Samples, settle_samples: int, omegas: FloatArray, plan: ExcitationPlan
) -> FrequencyResponse:
    """Estimate z from what a robot did between the ramps, of which it was to settle first."""
    tones, step_s = len(omegas), plan.sample_time_s
    extra = resolvable_harmonics(omegas, step_s, plan.segments * plan.segment_samples * step_s)
    every_omega = np.concatenate([omegas, extra])
    ringing = ring_down(between.y, every_omega, float(omegas.max()), step_s, settle_samples)
    start, transient = settle_samples, None
    if ringing.lasting.any():
        # A transient is known best where it is largest, so that all of it is fitted.
        start = len(between.y) % plan.segments
        transient = ringing.columns(len(between.y), step_s)[start:]
    samples = replace(between, u=between.u[start:], y=between.y[start:])
    try:
        input_fit, output_fit = fit_sinusoids(
            [samples.u, samples.y], every_omega, step_s, plan.segments, transient
        )
    except UnresolvableError as error:
        return _failed(omegas, plan, "unresolvable", str(error))
    input_tones = input_fit.phasors[:tones]
    if np.min(np.abs(input_tones)) < REFERENCE_TONE_MIN:
        return _failed(omegas, plan, "no-reference", "a tone is missing from the reference")
    scaled_z = output_fit.phasors[:tones] / input_tones
    # z of each segment to first order, z + (Y_p − z U_p)/U: dividing by the segment's own U_p would
    # be biased if the reference scattered too.
    segment_output = output_fit.segment_phasors[:, :tones]
    segment_input = input_fit.segment_phasors[:, :tones]
    segment_z = scaled_z + (segment_output - scaled_z * segment_input) / input_tones
    gain = samples.y_scale / samples.u_scale
    tested = Tested(
        measured=samples.y,
        tones=sum_of_tones(output_fit.phasors[:tones], omegas, step_s, len(samples.y)),
        residual=samples.y - output_fit.fitted,
        omega_rad_s=omegas,
        amplitudes=np.abs(output_fit.phasors[:tones]),
        sample_time_s=step_s,
    )
    suspected = list(suspicions(tested))
    variance = output_fit.scatter_factor[:tones] * variance_of_mean(gain * segment_z)
    # Systematic errors do not show as scatter; a bound on each is added to the variance instead.
    for suspicion in suspected:
        variance += (gain * suspicion.phasor_error / np.abs(input_tones)) ** 2
    degrees = output_fit.scatter_degrees[:tones]
    estimates = _Estimates(gain * segment_z, variance, degrees)
    findings = _findings(tested, samples, ringing, input_fit, output_fit, estimates, plan)
    findings.append(still_ringing(ringing, settle_samples * step_s))
    return FrequencyResponse(
        omega_rad_s=omegas,
        z=gain * scaled_z,
        variance=variance,
        segments=plan.segments,
        quality=verdict([*findings, *(suspicion.finding for suspicion in suspected)]),
        degrees=degrees,
        amplitude=plan.amplitude,
    )


def _findings(
    tested: Tested,
    samples: _Samples,
    ringing: RingDown,
    input_fit: SinusoidFit,
    output_fit: SinusoidFit,
    estimates: _Estimates,
    plan: ExcitationPlan,
) -> list[Finding | None]:
    omegas, segments, step_s = tested.omega_rad_s, plan.segments, plan.sample_time_s
    segment_z, variance, degrees = estimates.segment_z, estimates.variance, estimates.degrees
    tones, z = len(omegas), segment_z.mean(axis=0)
    moved, residual = tested.tones, tested.residual
    played, usual = (
        sum_of_tones(phasors, omegas, step_s, len(samples.y))
        for phasors in (
            input_fit.phasors[:tones],
            # The median is robust to one bad segment; the mean would spread its error over all.
            complex_median(output_fit.segment_phasors[:, :tones]),
        )
    )
    silent = (tested.amplitudes <= SILENCE) | (
        np.abs(z) <= uncertainty_radius(variance, degrees, NO_RESPONSE_SIGNIFICANCE)
    )
    # Converted to the scaled output's unit; an output of zeros was not scaled.
    reference_rms = float(np.std(samples.u)) * samples.u_scale / (samples.y_scale or math.inf)
    findings: list[Finding | None] = [
        *sensor_faults(samples.y, moved, samples.y_scale),
        unexplained(reference_rms, samples.y, residual),
        *uncertain(omegas, silent, geodesic_radius(z, uncertainty_radius(variance, degrees))),
    ]
    # A change makes estimates of segments scatter as if noise hid the response.
    if silent.any() and not ringing.lasting.any():
        midway = changed_midway(residual, moved, output_fit.omega_rad_s, tones, step_s)
        if midway is not None:
            return [*findings, midway]
    if silent.all():
        return [
            *findings,
            stopped(ringing.unexplained, residual),
            disturbed(residual, moved, segments),
        ]
    distortion = harmonic_distortion(output_fit, tones, residual)
    # For a single tone the powers contain nothing but harmonics, which were tested above.
    if tones > 1:
        powers = power_distortion(residual, (moved, played), omegas, step_s, segments)
        odd = intermodulation(output_fit, tones, residual, step_s)
        distortion = max(distortion, powers, odd)
    gain = samples.y_scale / samples.u_scale
    # A change dY of the output's phasor moves z by dY/U, and its point on the Riemann sphere by
    # |dz| / (1 + |z|²), the metric that the chordal distance has for close points.
    on_the_sphere = gain / np.abs(input_fit.phasors[:tones]) / (1 + np.abs(z) ** 2)
    settling = unsettled(segment_z, omegas)
    if settling is None or settling.code != "unsettled":
        findings.append(changed(residual, on_the_sphere, omegas, step_s))
    return [
        *findings,
        disturbed(residual + moved - usual, moved, segments),
        settling,
        nonlinear(distortion),
    ]


def _failed(omegas: FloatArray, plan: ExcitationPlan, code: str, text: str) -> FrequencyResponse:
    return FrequencyResponse(
        omega_rad_s=omegas,
        z=np.full(len(omegas), complex(np.nan, np.nan)),
        variance=np.full(len(omegas), np.inf),
        segments=plan.segments,
        quality=Quality(reasons=(Finding(code=code, text=text),)),
        amplitude=plan.amplitude,
    )
