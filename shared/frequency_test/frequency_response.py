"""The response z(ω) of a robot from one frequency test, with its uncertainty and a verdict.

z(ω) = A(ω) e^{jθ(ω)} is the paper's eq. (5): amplitude gain A and phase shift θ from reference to
output. Where a test plays on several axes, z_ij(ω) leads from the reference of axis j to the output
of axis i, and is estimated at the tones of axis j (Pintelon and Schoukens, System Identification,
2nd ed., Wiley 2012, chapter 2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.excitation import ExcitationPlan
from nufleet.shared.frequency_test.hidden_transient import (
    PROBABLE,
    HiddenTransient,
    hidden_transient,
    may_ring,
    told_from_tones,
)
from nufleet.shared.frequency_test.matrix_response import MatrixResponse, error_correlation
from nufleet.shared.frequency_test.quality import (
    BoolArray,
    Finding,
    Quality,
    uncertainty_radius,
    verdict,
)
from nufleet.shared.frequency_test.repetition import period_samples
from nufleet.shared.frequency_test.response_findings import Estimates, Samples, findings_of
from nufleet.shared.frequency_test.ring_down import (
    DECAYS_UNTIL_SETTLED,
    RingDown,
    ring_down,
    still_ringing,
)
from nufleet.shared.frequency_test.sinusoid_fit import (
    SinusoidFit,
    UnresolvableError,
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

SLIGHT = 0.2
"""Probability of distortion in a test of several axes from which a decay that was found may be what
beats. Where it is `PROBABLE`, nothing is said to ring if the tones do not repeat."""


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
    hidden_variance: FloatArray | None = None
    """Part of each variance that is due to a transient which the tones may hide, shape (tones,);
    None if nothing is known of it."""
    matrix: MatrixResponse | None = None
    """All entries of a test of several axes, of which this is the first axis's own; None for a test
    of one axis."""
    axis: str | None = None
    """Name of the axis, the first of a test of several; None where it is not known."""

    @property
    def own_entries(self) -> dict[str, FrequencyResponse]:
        """Response of each axis that played to its own reference, by axis; none where the axis is
        not known."""
        if self.matrix is not None:
            return {axis: self.matrix.entry(i, i) for i, axis in enumerate(self.matrix.axes)}
        return {} if self.axis is None else {self.axis: self}

    @property
    def degrees_of_freedom(self) -> FloatArray:
        """Degrees of freedom of each variance, shape (tones,)."""
        if self.degrees is not None:
            return self.degrees
        return np.full(len(self.omega_rad_s), 2.0 * (self.segments - 1))

    @property
    def noise_variance(self) -> FloatArray:
        """Variance of each estimate without what a hidden transient adds to it, shape (tones,)."""
        return (
            self.variance if self.hidden_variance is None else self.variance - self.hidden_variance
        )

    def delayed(self, std_s: float) -> FrequencyResponse:
        """Return the response with a variance that includes an unknown delay of the output.

        A delay δ turns z by ω δ. It is the same at all tones of a test, which their variances, one
        by one, do not say: what is averaged over tones is less certain than they make it.

        Args:
            std_s: Standard deviation of the delay.
        """

        def turned(one: FrequencyResponse) -> FrequencyResponse:
            more = (one.omega_rad_s * std_s * np.abs(one.z)) ** 2
            return replace(one, variance=one.variance + more)

        if std_s == 0:
            return self
        matrix = self.matrix
        if matrix is not None:
            matrix = replace(matrix, rows=tuple(turned(row) for row in matrix.rows))
        return replace(turned(self), matrix=matrix)

    def times(self, factor: FloatArray) -> FrequencyResponse:
        """Return the response in another unit.

        Args:
            factor: What one old unit is in new ones at each tone, shape (tones,).
        """
        hidden = self.hidden_variance
        return replace(
            self,
            z=self.z * factor,
            variance=self.variance * factor**2,
            hidden_variance=None if hidden is None else hidden * factor**2,
        )

    def at(self, tones: BoolArray) -> FrequencyResponse:
        """Return the response at some tones.

        Args:
            tones: True at these, shape (tones,).
        """
        degrees, hidden = self.degrees, self.hidden_variance
        return replace(
            self,
            omega_rad_s=self.omega_rad_s[tones],
            z=self.z[tones],
            variance=self.variance[tones],
            degrees=None if degrees is None else degrees[tones],
            hidden_variance=None if hidden is None else hidden[tones],
        )

    def radius(self, alpha: float = 0.05) -> FloatArray:
        """Return the radius ρ of the disc around each ẑ that holds z with probability 1 − α.

        Args:
            alpha: Probability α that a disc misses z.

        Returns:
            Radii in the complex plane, shape (tones,).
        """
        return uncertainty_radius(self.variance, self.degrees_of_freedom, alpha)


def estimate_frequency_response(
    reference: FloatArray, response: FloatArray, plan: ExcitationPlan
) -> FrequencyResponse:
    """Estimate z at every tone of a test from the samples of its measuring part.

    All tones, an offset, a drift and second and third harmonics are fitted jointly to the whole
    measuring part; the variance comes from the contributions of the single segments. (The mean of
    phasors fitted to each segment alone has up to 2.8 times the variance: within one period a drift
    looks like a sine.) Faults in the samples lead to a verdict, never to an exception.

    Args:
        reference: Reference of the tested axis, shape (samples,), in the axis's unit, or those of
            all tested axes, shape (samples, axes), in the order of `plan.played`.
        response: Output measured at the same times, in the same shape and units.
        plan: Excitation that the robot played.

    Returns:
        The response of the first axis that played to its own reference; for a test of several axes,
        its `matrix` has all entries, and its verdict is that on all axes.
    """
    references, outputs = (
        signal if signal.ndim == 2 else signal[:, None] for signal in (reference, response)
    )
    matrix = _matrix(references, outputs, plan)
    if len(matrix.axes) == 1:
        return matrix.rows[0]
    return replace(matrix.entry(0, 0), quality=matrix.quality, matrix=matrix)


def _matrix(references: FloatArray, outputs: FloatArray, plan: ExcitationPlan) -> MatrixResponse:
    """Estimate all entries; references and outputs have shape (samples, axes)."""
    tested = _Tested.of(plan)
    first = plan.first_measured_sample
    end = first + plan.segments * plan.segment_samples
    if min(len(references), len(outputs)) < end:
        text = f"the test ended early: {len(outputs)} samples, but measuring ends at sample {end}"
        return tested.failed("ended-early", text)
    for name, signals in (("reference", references), ("output", outputs)):
        bad = np.flatnonzero(~np.isfinite(signals[first:end]).all(axis=1))
        if len(bad):
            text = f"the {name} contains {len(bad)} samples that are not finite"
            return tested.failed("not-finite", text)
    # The axes' tones differ, so that the sum of all references contains each of them once. In its
    # sum each reference counts in the first one's unit, by the ratio of their amplitudes.
    reference = (references / tested.scale).sum(axis=1)
    # Scaled to 1, so that no square overflows, however far the robot has moved.
    u_scale = float(np.max(np.abs(reference[first:end])))
    if u_scale == 0.0:
        return tested.failed("no-reference", "the reference is zero throughout")
    begin = plan.ramp_samples
    between = []
    for output, scale in zip(outputs.T, tested.scale.tolist(), strict=True):
        own_scale, y_scale = u_scale * scale, float(np.max(np.abs(output[first:end])))
        if y_scale > GAIN_MAX * own_scale:
            text = f"the output reaches {y_scale:.2g} with a reference of {own_scale:.2g}"
            return tested.failed("unexplained", f"{text}: it ran away")
        before = np.stack([reference[plan.ramp_samples : first], output[plan.ramp_samples : first]])
        most = GAIN_MAX * own_scale
        if not np.all(np.isfinite(before)) or np.max(np.abs(before), initial=0.0) > most:
            begin = first
        between.append(Samples(reference / u_scale, output / (y_scale or 1.0), own_scale, y_scale))
    return _estimate([one[begin:end] for one in between], first - begin, tested)


@dataclass(frozen=True)
class _Tested:
    """What a plan tests: its tones, and which axis plays each of them."""

    plan: ExcitationPlan
    omega_rad_s: FloatArray
    """Frequencies of all tones, axis by axis, shape (tones,)."""
    played_by: NDArray[np.intp]
    """Place of the axis that plays each tone, shape (tones,)."""
    scale: FloatArray
    """Amplitude of each axis, as a multiple of the first one's, shape (axes,)."""

    @staticmethod
    def of(plan: ExcitationPlan) -> _Tested:
        counts = [len(one.tones) for one in plan.played]
        omegas = [tone.omega_rad_s for one in plan.played for tone in one.tones]
        amplitudes = np.array([one.amplitude for one in plan.played])
        played_by = np.repeat(np.arange(len(counts)), counts)
        return _Tested(plan, np.array(omegas), played_by, amplitudes / plan.amplitude)

    def matrix(
        self, rows: Sequence[FrequencyResponse], correlation: ComplexArray
    ) -> MatrixResponse:
        axes = tuple(one.axis for one in self.plan.played)
        return MatrixResponse(axes, self.played_by, tuple(rows), correlation)

    def failed(self, code: str, text: str) -> MatrixResponse:
        omegas, plan = self.omega_rad_s, self.plan
        rows = [
            FrequencyResponse(
                omega_rad_s=omegas,
                z=np.full(len(omegas), complex(np.nan, np.nan)),
                variance=np.full(len(omegas), np.inf),
                segments=plan.segments,
                quality=Quality(reasons=(Finding(code=code, text=text),)),
                amplitude=one.amplitude,
                axis=one.axis,
            )
            for one in plan.played
        ]
        return self.matrix(rows, np.eye(len(rows), dtype=np.complex128))


def _estimate(between: Sequence[Samples], settle_samples: int, asked: _Tested) -> MatrixResponse:
    """Estimate z from what a robot did between the ramps, of which it was to settle first.

    Args:
        between: Reference and output of each axis.
        settle_samples: Number of samples before the measuring part.
        asked: Tones of the test, with its plan.
    """
    plan, omegas = asked.plan, asked.omega_rad_s
    tones, step_s = len(omegas), plan.sample_time_s
    extra = resolvable_harmonics(omegas, step_s, plan.segments * plan.segment_samples * step_s)
    every_omega = np.concatenate([omegas, extra])
    # Some of the many products of several axes' tones look like a decay.
    several = len(between) > 1
    measured = plan.segments * plan.segment_samples
    # Segments are rounded up to whole samples.
    period = period_samples(omegas, step_s, measured, plan.segments) if several else None
    rows, left = [], []
    for axis, one in enumerate(between):
        ringing = ring_down(one.y, every_omega, float(omegas.max()), step_s, settle_samples)
        start, transient = settle_samples, None
        if ringing.lasting.any():
            # A transient is known best where it is largest, so that all of it is fitted.
            start, transient = len(one.y) % plan.segments, ringing.columns(len(one.y), step_s)
        waited_s = settle_samples * step_s
        hides = partial(hidden_transient, one.y, every_omega, tones, step_s, start, waited_s)
        hidden = hides(transient, period=period)
        rings = still_ringing(ringing, waited_s) or may_ring(hidden, waited_s)
        if rings and several:
            if _may_beat(ringing, hidden, len(one.y) * step_s):
                too = may_ring(hides(None, period=period), waited_s)
                rings = too and min(rings, too, key=lambda one: one.value or 0.0)
            if period is None and _may_be_products(rings, hidden, len(one.y) * step_s):
                rings = None
        samples = one[start:]
        try:
            input_fit, output_fit = fit_sinusoids(
                [samples.u, samples.y],
                every_omega,
                step_s,
                plan.segments,
                None if transient is None else transient[start:],
            )
        except UnresolvableError as error:
            return asked.failed("unresolvable", str(error))
        if np.min(np.abs(input_fit.phasors[:tones])) < REFERENCE_TONE_MIN:
            return asked.failed("no-reference", "a tone is missing from the reference")
        own = asked.played_by == axis
        row = _row(samples, ringing, rings, hidden, input_fit, output_fit, own, asked)
        # z was relative to a reference that counts in the unit of this output.
        rows.append(row.times(asked.scale[axis] / asked.scale[asked.played_by]))
        left.append((samples.y - output_fit.fitted)[settle_samples - start :])
    return asked.matrix(rows, error_correlation(np.array(left), float(omegas.max()), step_s))


def _may_beat(ringing: RingDown, hidden: HiddenTransient | None, length_s: float) -> bool:
    """Return whether a decay that was found in a test of several axes may be distortion."""
    found = bool(ringing.lasting.any()) and not told_from_tones(ringing, length_s)
    return found and hidden is not None and hidden.distorted > SLIGHT


def _may_be_products(
    rings: Finding | None, hidden: HiddenTransient | None, length_s: float
) -> bool:
    """Return whether what rings may be products of tones that do not repeat in a record.

    It may if it hardly decays, or if there is distortion besides it.
    """
    settling_s = (rings and rings.value) or 0.0
    distorted = hidden is not None and hidden.distorted > PROBABLE
    return distorted or settling_s > DECAYS_UNTIL_SETTLED * length_s


def _row(
    samples: Samples,
    ringing: RingDown,
    rings: Finding | None,
    hidden: HiddenTransient | None,
    input_fit: SinusoidFit,
    output_fit: SinusoidFit,
    own: BoolArray,
    asked: _Tested,
) -> FrequencyResponse:
    """Return the responses of one output to all tones."""
    plan, omegas, step_s = asked.plan, asked.omega_rad_s, asked.plan.sample_time_s
    tones = len(omegas)
    input_tones = input_fit.phasors[:tones]
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
    estimates = Estimates(gain * segment_z, variance, degrees)
    findings = findings_of(tested, samples, ringing, input_fit, output_fit, estimates, own, plan)
    findings.append(rings)
    hidden_variance = None
    if hidden is not None:
        hidden_variance = hidden.variance * (gain / np.abs(input_tones)) ** 2
    played = plan.played[int(asked.played_by[own][0])]
    return FrequencyResponse(
        omega_rad_s=omegas,
        z=gain * scaled_z,
        variance=variance if hidden_variance is None else variance + hidden_variance,
        segments=plan.segments,
        quality=verdict([*findings, *(suspicion.finding for suspicion in suspected)]),
        degrees=degrees,
        amplitude=played.amplitude,
        hidden_variance=hidden_variance,
        axis=played.axis,
    )
