"""Detection of suspect samples in a test, and bounds on the error they may cause in its estimate.

A few suspect samples do not make a test useless, but they do not show as scatter between segments
either, because a fault that lasts throughout the test affects every segment alike. Each kind of
fault found here therefore comes with a bound on the error of each phasor, which is added to the
variance of the estimate.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import Finding, middle_of
from nufleet.shared.frequency_test.sensor_faults import repeated_runs, resolution_of

SPIKE_DEVIATIONS = 7.0
"""Distance of a spike from the median of its neighbours, in standard deviations of the noise."""

SPIKE_NEIGHBOURS = 7
SPIKE_SURROUNDINGS = 31
"""Number of samples in the median that a spike departs from, and number of samples around it that
the usual size of such departures is taken from."""

SPIKES_MAX = 0.1
"""Largest fraction of spikes; with more, correct samples can no longer be identified."""

NORMAL_DEVIATION = 1.4826
"""Standard deviation of normally distributed noise whose median magnitude is 1."""

LATE_SIGNIFICANCE = 5.0
"""Number of standard errors by which the noise must grow with the output's speed to count as late
samples."""

NEGLIGIBLE = 1e-6
"""Fraction of the output below which deviations are ignored as rounding and imperfections of the
fit."""

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Suspicion:
    """A finding about suspect samples, and a bound on the error they cause."""

    finding: Finding
    """The finding in words."""
    phasor_error: FloatArray
    """Bound on the error of each phasor of the output, shape (tones,), in the output's unit."""


@dataclass(frozen=True)
class Tested:
    """The output of a test and its fit, all in one unit."""

    measured: FloatArray
    """Measured output, shape (samples,)."""
    tones: FloatArray
    """Part of the fit that responds to the reference, shape (samples,)."""
    residual: FloatArray
    """Output minus the whole fit, shape (samples,)."""
    omega_rad_s: FloatArray
    """Frequencies of the tones, shape (tones,)."""
    amplitudes: FloatArray
    """Amplitudes of the tones in the output, shape (tones,)."""
    sample_time_s: float
    """Time between samples."""

    def phasor_error(self, error: FloatArray) -> FloatArray:
        """Return the magnitude of the error that errors of single samples cause in each phasor.

        To good approximation it is |2/N Σ e_k e^{−jω t_k}|, as if the tones were orthogonal.

        Args:
            error: Errors of the samples in the output's unit, shape (samples,), mostly zero.

        Returns:
            Errors of the phasors in the output's unit, shape (tones,).
        """
        index = np.flatnonzero(error)
        phase = np.outer(self.omega_rad_s, index * self.sample_time_s)
        return np.asarray(2 * np.abs(np.exp(-1j * phase) @ error[index]) / len(error))


def suspicions(tested: Tested) -> Iterator[Suspicion]:
    """Yield every suspicion about single samples of a test: held, spikes, late.

    Args:
        tested: Output of the test and its fit.
    """
    held = _held(tested)
    if held.any():
        yield Suspicion(
            Finding(
                code="held-samples",
                text=f"{_share(held)} of the samples only repeat the one before: they were lost",
            ),
            tested.phasor_error(held),
        )
    spikes = np.where(_is_spike(tested), tested.residual, 0.0)
    if spikes.any():
        many = np.count_nonzero(spikes) > SPIKES_MAX * len(spikes)
        yield Suspicion(
            Finding(
                code="too-many-spikes" if many else "spikes",
                text=f"{_share(spikes)} of the samples are spikes far away from all others",
            ),
            tested.phasor_error(spikes),
        )
    late_s = _late_deviation_s(tested, (held != 0) | (spikes != 0))
    if late_s > 0:
        yield Suspicion(
            Finding(
                code="late-samples",
                text="the noise grows with the speed, as if samples were delayed by varying times "
                f"of up to {2e3 * math.sqrt(3) * late_s:.2g} ms",
            ),
            math.sqrt(3) * late_s * tested.omega_rad_s * tested.amplitudes,
        )


def _held(tested: Tested) -> FloatArray:
    """Return the errors of samples that only repeat the previous one, shape (samples,).

    The error of a genuine sample is 0. A sensor that is slower than the loop always repeats its
    samples a usual number of times; only longer runs count.
    """
    measured, tones = tested.measured, tested.tones
    starts, lengths = repeated_runs(measured)
    error = np.zeros(len(measured))
    if len(starts) in (1, len(measured)):
        return error
    usual = int(middle_of(lengths))
    longer = np.flatnonzero(lengths > usual)
    if not len(longer):
        return error
    motion_min = max(2 * resolution_of(measured), NEGLIGIBLE)
    for run in longer:
        moved = tones[starts[run] : starts[run] + lengths[run]]
        if np.ptp(moved) > motion_min:
            begin = starts[run] + usual
            error[begin : starts[run] + lengths[run]] = moved[usual - 1] - moved[usual:]
    return error


def _is_spike(tested: Tested) -> BoolArray:
    """Return True for samples that depart from their neighbours, shape (samples,).

    They must do so both in the measured output and in the residual. In the output alone, the
    turning points of fast tones would count; in the residual alone, the steps of a slow sensor.
    """
    away = _off_the_median(tested.residual)
    # The usual departure is taken over the whole test and around the sample, so that a transient is
    # not taken for a spike. Samples that equal the median of their neighbours, of which there are
    # many in slow noise, carry no information on the noise's size and are left out.
    in_all = middle_of(away[away > 0]) if away.any() else 0.0
    if away.max() <= max(SPIKE_DEVIATIONS * NORMAL_DEVIATION * in_all, NEGLIGIBLE):
        return np.zeros(len(away), dtype=np.bool_)
    usual = np.maximum(in_all, median_filter(away, SPIKE_SURROUNDINGS))
    limit = np.maximum(SPIKE_DEVIATIONS * NORMAL_DEVIATION * usual, NEGLIGIBLE)
    return np.asarray((away > limit) & (_off_the_median(tested.measured) > limit))


def _off_the_median(signal: FloatArray) -> FloatArray:
    """Return the distance of each sample from the median of its neighbours, shape (samples,)."""
    half = SPIKE_NEIGHBOURS // 2
    # An odd reflection continues the trend at both ends, so that the end samples are not peaks.
    beyond = np.concatenate(
        [
            2 * signal[0] - signal[half:0:-1],
            signal,
            2 * signal[-1] - signal[-2 : -half - 2 : -1],
        ]
    )
    return np.abs(signal - median_filter(beyond, SPIKE_NEIGHBOURS)[half:-half])


def _late_deviation_s(tested: Tested, bad: BoolArray) -> float:
    """Return the standard deviation of the sampling times, or 0 if it is not significant.

    A sample taken δ too late is off by δ times the output's speed, so the variance of the noise
    grows with the square of the speed, at the rate Var δ. A constant part of δ cannot be seen; it
    looks like a slower robot. If δ is uniform between 0 and a largest delay, its mean is √3
    standard deviations. Differencing neighbouring samples removes slow disturbances.

    Args:
        tested: Output of the test and its fit.
        bad: True for samples with another fault, which are left out, shape (samples,).

    Returns:
        Standard deviation in seconds.
    """
    step_s = tested.sample_time_s
    speed = np.diff(tested.tones) / step_s
    good = ~(bad[1:] | bad[:-1])
    squares, speeds = 0.5 * np.diff(tested.residual)[good] ** 2, speed[good] ** 2
    if len(squares) < 30:
        return 0.0
    centred = speeds - speeds.mean()
    spread = float(centred @ centred)
    if spread <= 0.0:
        return 0.0
    # Regression of the squared noise on the squared speed. Its standard error is White's, which
    # allows the noise of the squares to grow with the speed.
    slope = float(centred @ squares) / spread
    left = squares - squares.mean() - slope * centred
    error = float(np.sqrt(np.sum((centred * left) ** 2))) / spread
    if slope <= LATE_SIGNIFICANCE * error or slope * float(speeds.max()) <= NEGLIGIBLE**2:
        return 0.0
    return float(np.sqrt(slope))


def _share(errors: FloatArray) -> str:
    return f"{100 * np.count_nonzero(errors) / len(errors):.2g} %"
