"""Samples of a test that are not what they should be, and how far they may move its estimate.

Few of them do not make a test useless, but they do not show as scatter between segments either:
what is wrong all along is wrong in every segment alike. So each kind found here says how much it
may have moved each phasor, which the estimate's variance then carries.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.frequency_test.sensor_faults import repeated_runs, resolution_of

SPIKE_DEVIATIONS = 7.0
"""A spike leaves the median of its neighbours by so many standard deviations of the others."""

SPIKE_NEIGHBOURS = 7
SPIKE_SURROUNDINGS = 31
"""Samples whose median a spike leaves, and samples that say what is usual around it."""

SPIKES_MAX = 0.1
"""With a larger share of spikes nobody knows which samples are the right ones."""

NORMAL_DEVIATION = 1.4826
"""Standard deviation of normal noise whose median magnitude is 1."""

LATE_SIGNIFICANCE = 5.0
"""Standard errors by which the noise has to grow with the output's speed."""

NEGLIGIBLE = 1e-6
"""Share of the output below which nothing is suspected: rounding, and what a fit leaves over."""

BoolArray = NDArray[np.bool_]


@dataclass(frozen=True)
class Suspicion:
    """A finding, and by how much what was found may have moved each phasor, shape (tones,)."""

    finding: Finding
    phasor_error: FloatArray


@dataclass(frozen=True)
class Tested:
    """The output of a test and what was made of it, each of shape (samples,) and in one unit.

    `tones` is the part of the fit that responds to the reference, `residual` what the whole fit
    leaves over. `omega_rad_s` and `amplitudes` of the output have shape (tones,).
    """

    measured: FloatArray
    tones: FloatArray
    residual: FloatArray
    omega_rad_s: FloatArray
    amplitudes: FloatArray
    sample_time_s: float

    def phasor_error(self, error: FloatArray) -> FloatArray:
        """Return what errors of single samples, shape (samples,), do to each phasor."""
        index = np.flatnonzero(error)
        phase = np.outer(self.omega_rad_s, index * self.sample_time_s)
        return np.asarray(2 * np.abs(np.exp(-1j * phase) @ error[index]) / len(error))


def suspicions(tested: Tested) -> Iterator[Suspicion]:
    """Yield what is suspicious about single samples of a test."""
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
                text=f"{_share(spikes)} of the samples are spikes that leave all others",
            ),
            tested.phasor_error(spikes),
        )
    late_s = _late_deviation_s(tested, (held != 0) | (spikes != 0))
    if late_s > 0:
        yield Suspicion(
            Finding(
                code="late-samples",
                text="the noise grows with the speed, as if samples were late by anything up to "
                f"{2e3 * math.sqrt(3) * late_s:.2g} ms",
            ),
            math.sqrt(3) * late_s * tested.omega_rad_s * tested.amplitudes,
        )


def _held(tested: Tested) -> FloatArray:
    """Return the errors of samples that repeat the one before, 0 where a sample is its own.

    A sensor that is slower than the loop repeats itself by as much as it always does.
    """
    measured, tones = tested.measured, tested.tones
    starts, lengths = repeated_runs(measured)
    error = np.zeros(len(measured))
    usual = int(np.median(lengths))
    longer = np.flatnonzero(lengths > usual)
    if len(starts) == 1 or not len(longer):
        return error
    motion_min = max(2 * resolution_of(measured), NEGLIGIBLE)
    for run in longer:
        moved = tones[starts[run] : starts[run] + lengths[run]]
        if np.ptp(moved) > motion_min:
            begin = starts[run] + usual
            error[begin : starts[run] + lengths[run]] = moved[usual - 1] - moved[usual:]
    return error


def _is_spike(tested: Tested) -> BoolArray:
    """Return which samples leave their neighbours, both as measured and in the residual.

    As measured alone, the turning points of fast tones would count; in the residual alone, the
    steps of a slow sensor.
    """
    away, alone = _off_the_median(tested.residual), _off_the_median(tested.measured)
    # Of the whole test, and around the sample: a transient is no spike. Samples that are the median
    # themselves, many in slow noise, say nothing of its size.
    in_all = float(np.median(away[away > 0])) if away.any() else 0.0
    usual = np.maximum(in_all, median_filter(away, SPIKE_SURROUNDINGS))
    limit = np.maximum(SPIKE_DEVIATIONS * NORMAL_DEVIATION * usual, NEGLIGIBLE)
    return np.asarray((away > limit) & (alone > limit))


def _off_the_median(signal: FloatArray) -> FloatArray:
    """Return how far each sample is from the median of its neighbours."""
    half = SPIKE_NEIGHBOURS // 2
    # Beyond its ends a signal goes on as it came, so that the first and last sample are no peaks.
    beyond = np.pad(signal, half, mode="reflect", reflect_type="odd")
    return np.abs(signal - median_filter(beyond, SPIKE_NEIGHBOURS)[half:-half])


def _late_deviation_s(tested: Tested, bad: BoolArray) -> float:
    """Return the standard deviation of the samples' times, 0 where nothing tells of one.

    A sample taken δ too late is off by δ times the output's speed: the noise's variance grows with
    the square of the speed, by Var δ. A part of δ that never changes cannot be seen; it looks like
    a slower robot; where δ is anything between none and a largest delay, its mean is √3 deviations.
    Differences of neighbouring samples leave slow disturbances out.

    Args:
        tested: the test.
        bad: samples with a fault of their own, to be left out.
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
    slope = float(centred @ squares) / spread
    left = squares - squares.mean() - slope * centred
    error = float(np.sqrt(np.sum((centred * left) ** 2))) / spread
    if slope <= LATE_SIGNIFICANCE * error or slope * float(speeds.max()) <= NEGLIGIBLE**2:
        return 0.0
    return float(np.sqrt(slope))


def _share(errors: FloatArray) -> str:
    return f"{100 * np.count_nonzero(errors) / len(errors):.2g} %"
