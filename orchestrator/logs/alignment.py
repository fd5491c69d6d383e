"""Brings two signals of a log to the robot's sample times, without bridging what is missing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from nufleet.orchestrator.logs.signals import LogError, Signal
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.record_response import Stretch

GAP_SAMPLES = 3.0
"""Interval that counts as a gap, in usual intervals; shorter than 2.5 robot samples none is."""

GAP_ROBOT_SAMPLES = 2.5

DISORDER_MAX = 0.01
"""Largest share of time stamps that may step back; with more, the log is of two clocks or runs."""

INTERPOLATED_RAD = 0.8
"""Phase by which the highest frequency may turn from one sample of the output to the next: a cubic
spline then errs by 0.3 %."""

STRETCH_MIN_SAMPLES = 16

ROUNDING = 1e-3
"""Part of a sample by which time stamps may differ that mean the same instant."""


@dataclass(frozen=True)
class Timing:
    """How one signal was sampled."""

    samples: int
    """Number of samples within the trims."""
    interval_s: float
    """Median of the time from one sample to the next."""
    jitter_s: float
    """Standard deviation of that time, without gaps."""
    gaps: int
    """Number of gaps."""
    disordered: int
    """Number of time stamps that do not lie after the one before; these samples were left out."""


@dataclass(frozen=True, eq=False)
class Aligned:
    """Reference and output at the robot's sample times."""

    stretches: tuple[Stretch, ...]
    """Parts without gaps, in the order of the log."""
    reference: Timing
    """How the reference was sampled."""
    output: Timing
    """How the output was sampled."""
    omega_max_rad_s: float
    """Highest frequency at which the output can be interpolated."""
    delay_std_s: float
    """Standard deviation of the delay that the time stamps leave open."""
    began_s: float
    """Time stamp of the first sample that was used."""


def align(
    reference: Signal,
    output: Signal,
    sample_time_s: float,
    *,
    begin_s: float = 0.0,
    end_s: float = math.inf,
) -> Aligned:
    """Bring both signals to a grid of sample times.

    The reference is what was sent last, as the robot had it; the output is interpolated by a cubic
    spline. Where either has a gap, the record is cut.

    Args:
        reference: Positions that the robot was sent.
        output: Positions that were measured, by the same clock.
        sample_time_s: Time between samples of the robot.
        begin_s: Time from the beginning of the log at which to begin.
        end_s: Time from the beginning of the log at which to end.

    Raises:
        LogError: The signals do not overlap, or one of them has no usable time stamps.
    """
    origin_s = min(float(np.min(reference.time_s)), float(np.min(output.time_s)))
    sent, measured = (
        _ordered(signal, origin_s, (begin_s, end_s)) for signal in (reference, output)
    )
    if max(sent.time_s[0], measured.time_s[0]) >= min(sent.time_s[-1], measured.time_s[-1]):
        raise LogError(
            f"{reference.name} spans {_span(sent)} and {output.name} "
            f"{_span(measured)} of the log: they have no time in common; are they of the "
            "same clock?"
        )
    # Stamps of the same instant may differ by rounding, of seconds since 1970 by 2e-7 s.
    rounding_s = ROUNDING * sample_time_s
    stretches, began_s = [], math.inf
    for start, end in _between(sent.gaps(sample_time_s), measured.gaps(sample_time_s)):
        count = math.floor((end - start) / sample_time_s + ROUNDING) + 1
        if count < STRETCH_MIN_SAMPLES:
            continue
        grid_s = start + np.arange(count) * sample_time_s
        latest = np.searchsorted(sent.time_s, grid_s + rounding_s, side="right") - 1
        there = (measured.time_s >= start - rounding_s) & (measured.time_s <= end + rounding_s)
        if np.count_nonzero(there) < STRETCH_MIN_SAMPLES // 4 + 2:
            continue
        spline = CubicSpline(measured.time_s[there] - start, measured.value[there])
        stretches.append(Stretch(sent.value[latest], np.asarray(spline(grid_s - start))))
        began_s = min(began_s, start)
    common_s = min(sent.time_s[-1], measured.time_s[-1]) - max(sent.time_s[0], measured.time_s[0])
    if not stretches and common_s < STRETCH_MIN_SAMPLES * sample_time_s:
        raise LogError(
            f"{reference.name} and {output.name} have {common_s:.3g} s in common, and the robot's "
            f"samples are {sample_time_s:g} s apart: is the unit of the times right? A table's is "
            "given as --time COLUMN:UNIT"
        )
    if not stretches:
        raise LogError(
            f"{reference.name} and {output.name} have no {STRETCH_MIN_SAMPLES} samples in a row "
            f"without a gap, of {sample_time_s:g} s each: log at a higher rate"
        )
    sent_timing, timing = sent.timing(sample_time_s), measured.timing(sample_time_s)
    return Aligned(
        stretches=tuple(stretches),
        reference=sent_timing,
        output=timing,
        omega_max_rad_s=INTERPOLATED_RAD / timing.interval_s,
        delay_std_s=_delay_std_s(reference, output, sent_timing, timing, sample_time_s),
        began_s=origin_s + began_s,
    )


@dataclass(frozen=True, eq=False)
class _Ordered:
    """Samples with rising time stamps."""

    time_s: FloatArray
    value: FloatArray
    disordered: int

    def timing(self, sample_time_s: float) -> Timing:
        intervals = np.diff(self.time_s)
        gaps = self.gaps(sample_time_s)
        usual = intervals[intervals <= self._longest_s(sample_time_s)]
        return Timing(
            samples=len(self.value),
            interval_s=float(np.median(intervals)),
            jitter_s=float(np.std(usual)) if len(usual) else 0.0,
            gaps=len(gaps) - 1,
            disordered=self.disordered,
        )

    def gaps(self, sample_time_s: float) -> list[tuple[float, float]]:
        """Return the first and the last time of every part without a gap."""
        cuts: NDArray[np.intp] = np.flatnonzero(
            np.diff(self.time_s) > self._longest_s(sample_time_s)
        )
        starts = np.concatenate([[0], cuts + 1])
        ends = np.concatenate([cuts, [len(self.time_s) - 1]])
        return list(zip(self.time_s[starts].tolist(), self.time_s[ends].tolist(), strict=True))

    def _longest_s(self, sample_time_s: float) -> float:
        usual_s = float(np.median(np.diff(self.time_s)))
        return max(GAP_SAMPLES * usual_s, GAP_ROBOT_SAMPLES * sample_time_s)


def _ordered(signal: Signal, origin_s: float, window_s: tuple[float, float]) -> _Ordered:
    """Return the samples of a window in s from the origin, their times from there as well."""
    from_origin_s = signal.time_s - origin_s
    inside = (from_origin_s >= window_s[0] - 1e-6) & (from_origin_s <= window_s[1] + 1e-6)
    time_s, value = from_origin_s[inside], signal.value[inside]
    if len(time_s) < STRETCH_MIN_SAMPLES // 4 + 2:
        raise LogError(
            f"{signal.name} has only {len(time_s)} samples between --from and --to: take more of "
            "the log"
        )
    latest = np.maximum.accumulate(time_s)
    # A sample that is not later than all before it came late or twice; it is left out.
    good = np.concatenate([[True], time_s[1:] > latest[:-1]])
    disordered = int(np.count_nonzero(~good))
    back = np.count_nonzero(np.diff(time_s) < 0)
    if back > DISORDER_MAX * len(time_s) or np.count_nonzero(good) < STRETCH_MIN_SAMPLES // 4 + 2:
        raise LogError(
            f"{back} of the {len(time_s)} time stamps of {signal.name} step back: they are of more "
            "than one clock or flight; cut the log with --from and --to"
        )
    return _Ordered(time_s[good], value[good], disordered)


def _between(
    first: Sequence[tuple[float, float]], second: Sequence[tuple[float, float]]
) -> list[tuple[float, float]]:
    """Return the intersections of two rising lists of intervals."""
    found, i, j = [], 0, 0
    while i < len(first) and j < len(second):
        start, end = max(first[i][0], second[j][0]), min(first[i][1], second[j][1])
        if start < end:
            found.append((start, end))
        if first[i][1] < second[j][1]:
            i += 1
        else:
            j += 1
    return found


def _delay_std_s(
    reference: Signal,
    output: Signal,
    sent: Timing,
    measured: Timing,
    sample_time_s: float,
) -> float:
    """Return what the stamps leave open of the time from the reference to the output.

    A reference that was logged more rarely than the robot takes samples may have been sent more
    often, and a sample stamped at its receipt was on its way for as long as its jitter shows.
    """
    parts = [sent.interval_s / math.sqrt(12) if sent.interval_s > 1.5 * sample_time_s else 0.0]
    parts += [
        timing.jitter_s
        for signal, timing in ((reference, sent), (output, measured))
        if signal.clock == "receipt"
    ]
    return math.hypot(*parts)


def _span(part: _Ordered) -> str:
    return f"{part.time_s[0]:.3f} to {part.time_s[-1]:.3f} s"
