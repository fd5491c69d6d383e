"""Detection of sensor faults from runs of identical samples: frozen and clipped outputs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import Finding, middle_of

IndexArray = NDArray[np.intp]

RUN_MIN_SAMPLES = 10
"""Length from which a run of identical samples may mean a stuck sensor. Shorter runs come from the
sensor's resolution or from lost samples."""

RUN_MOTION_MIN = 0.02
"""A run counts as a fault if the output should have moved by this fraction of its range during it.
"""

STUCK_MAX = 0.04
"""Largest share of samples in such runs that a test is used with. A tracker that sees its markers
hidden for some tenths of a second repeats what it saw; `suspect_samples` bounds what that does to
the estimates, and a longer test would only meet more of it."""

CUT_OFF_MIN_SAMPLES = 5
CUT_OFF_RATIO = 4.0
"""A sensor's range is taken to end at an extreme level if that level was read at least
`CUT_OFF_MIN_SAMPLES` times (in units of the usual run length), and more than `CUT_OFF_RATIO` times
as often as the level next to it. At the turning points of a quantised sinusoid the ratio stays
below 2.5."""


def sensor_faults(measured: FloatArray, tones: FloatArray, scale: float) -> Iterator[Finding]:
    """Yield findings about the sensor from runs of identical samples.

    Args:
        measured: Measured output, scaled, shape (samples,).
        tones: Fitted tones alone, that is the motion expected of the output, shape (samples,), in
            the same unit.
        scale: Value of 1 in the axis's unit, used in the text of the findings.
    """
    starts, lengths = repeated_runs(measured)
    if len(starts) == 1:
        yield Finding(
            code="frozen", text=f"the output stays at exactly {scale * measured[0]:.6g} throughout"
        )
        return
    bounds = _cut_off(measured, tones, starts, lengths)
    if bounds:
        yield Finding(
            code="clipped",
            text=f"the output is cut off at {' and '.join(f'{scale * b:.6g}' for b in bounds)}: "
            "a sensor or actuator saturates",
        )
        return
    # A coarse or slow sensor repeats samples too, but only within its resolution or update period.
    length_min = RUN_MIN_SAMPLES * max(1.0, middle_of(lengths))
    if lengths.max() < length_min:
        return
    motion_min = max(2 * resolution_of(measured), RUN_MOTION_MIN * float(np.ptp(tones)))
    stuck = [
        (int(start), int(length))
        for start, length in np.stack([starts, lengths], axis=-1)[lengths >= length_min]
        if np.ptp(tones[start : start + length]) > motion_min
    ]
    if sum(length for _, length in stuck) > STUCK_MAX * len(measured):
        start, length = max(stuck, key=lambda run: run[1])
        yield Finding(
            code="frozen",
            text=f"the output stays at exactly {scale * measured[start]:.6g} for {length} samples "
            "while the reference moves",
        )


def repeated_runs(measured: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Return the first index and the length of each run of identical samples.

    Args:
        measured: Samples in any unit, shape (samples,), at least one.

    Returns:
        Indices and lengths in samples, each of shape (runs,); a run may have a single sample.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(measured)) + 1])
    return starts, np.diff(np.concatenate([starts, [len(measured)]]))


def resolution_of(measured: FloatArray) -> float:
    """Return the smallest difference between distinct levels of a signal; 0 if it is constant.

    Args:
        measured: Samples in any unit, shape (samples,).
    """
    levels = np.unique(measured)
    return float(np.min(np.diff(levels))) if len(levels) > 1 else 0.0


def _cut_off(
    measured: FloatArray, tones: FloatArray, starts: IndexArray, lengths: IndexArray
) -> list[float]:
    """Return the levels at which the sensor's range ends, as far as the samples show them.

    A level counts only if the output reached it in at least two separate runs.
    """
    levels = measured[starts]
    usual = middle_of(lengths)
    bounds = []
    for sign in (-1.0, 1.0):
        bound = sign * float(np.max(sign * levels))
        if np.count_nonzero(levels == bound) <= 1:
            continue
        there = measured == bound
        inside = sign * float(np.max(sign * levels[levels != bound]))
        before = np.count_nonzero(measured == inside)
        often = np.count_nonzero(there) >= CUT_OFF_MIN_SAMPLES * usual
        alone = np.count_nonzero(there) > CUT_OFF_RATIO * before
        moved = np.ptp(tones[there]) > 2 * resolution_of(measured)
        if often and alone and moved:
            bounds.append(bound)
    return bounds
