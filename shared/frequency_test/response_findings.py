"""Everything that is found on one output of a test, from its samples and the fit of its tones."""

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
    BoolArray,
    Finding,
    changed,
    disturbed,
    stopped,
    uncertain,
    uncertainty_radius,
    unexplained,
    unsettled,
)
from nufleet.shared.frequency_test.ring_down import RingDown
from nufleet.shared.frequency_test.sensor_faults import sensor_faults
from nufleet.shared.frequency_test.sinusoid_fit import SinusoidFit, complex_median, sum_of_tones
from nufleet.shared.frequency_test.suspect_samples import Tested


@dataclass(frozen=True)
class Samples:
    """A part of a test, scaled so that the largest measured sample of each signal is 1."""

    u: FloatArray
    """Scaled reference, shape (samples,)."""
    y: FloatArray
    """Scaled output, shape (samples,)."""
    u_scale: float
    """Largest magnitude of the reference, in the unit of the output's axis."""
    y_scale: float
    """Largest magnitude of the output, in the axis's unit."""

    def __getitem__(self, part: slice) -> Samples:
        return replace(self, u=self.u[part], y=self.y[part])


@dataclass(frozen=True)
class Estimates:
    """The estimates of z from single segments, and the variance of their mean."""

    segment_z: ComplexArray
    """Estimate of z from each segment, shape (segments, tones)."""
    variance: FloatArray
    """Variance of their mean, shape (tones,)."""
    degrees: FloatArray
    """Degrees of freedom of that variance, shape (tones,)."""


def findings_of(
    tested: Tested,
    samples: Samples,
    ringing: RingDown,
    input_fit: SinusoidFit,
    output_fit: SinusoidFit,
    estimates: Estimates,
    own: BoolArray,
    plan: ExcitationPlan,
) -> list[Finding | None]:
    """Return the findings on one output, which must respond to its own tones alone."""
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
    silent, doubtful_rad = silent[own], geodesic_radius(z, uncertainty_radius(variance, degrees))
    # Converted to the scaled output's unit; an output of zeros was not scaled.
    reference_rms = float(np.std(samples.u)) * samples.u_scale / (samples.y_scale or math.inf)
    findings: list[Finding | None] = [
        *sensor_faults(samples.y, moved, samples.y_scale),
        unexplained(reference_rms, samples.y, residual),
        *uncertain(omegas[own], silent, doubtful_rad[own]),
    ]
    # A change makes estimates of segments scatter as if noise hid the response.
    if silent.any() and not ringing.lasting.any():
        midway = changed_midway(
            residual, output_fit.phasors[:tones], output_fit.omega_rad_s, step_s
        )
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
        # Before the measuring part, what decays at the frequency of a tone looks like a change.
        measured = residual[len(residual) - segments * plan.segment_samples :]
        findings.append(changed(measured, on_the_sphere, omegas, step_s))
    return [
        *findings,
        disturbed(residual + moved - usual, moved, segments),
        settling,
        nonlinear(distortion),
    ]
