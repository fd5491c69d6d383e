"""Faults of a sensor that show as runs of identical samples: frozen and clipped outputs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.quality import Finding

IndexArray = NDArray[np.intp]

RUN_MIN_SAMPLES = 10
"""Shorter runs of identical samples are a matter of resolution or of lost samples, not of a sensor
that is stuck."""

RUN_MOTION_MIN = 0.02
"""A run is a fault when the output should have moved by this share of its range meanwhile."""

CUT_OFF_MIN_SAMPLES = 5
CUT_OFF_RATIO = 4.0
"""A range ends where its last level was read so often, and so many times as often as the level
before: at the turning points of a quantised sinusoid that ratio stays below 2.5."""


def sensor_faults(measured: FloatArray, tones: FloatArray, scale: float) -> Iterator[Finding]:
    """Yield what runs of identical samples say of the sensor.

    Args:
        measured: the output, shape (samples,).
        tones: the fitted tones alone, shape (samples,): how the output should have moved.
        scale: what 1 stands for in the axis's unit, for the text.
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
    # A coarse or slow sensor repeats itself too, but never by more than its resolution or rate.
    motion_min = max(2 * resolution_of(measured), RUN_MOTION_MIN * float(np.ptp(tones)))
    length_min = RUN_MIN_SAMPLES * max(1.0, float(np.median(lengths)))
    stuck = [
        (int(start), int(length))
        for start, length in zip(starts, lengths, strict=True)
        if length >= length_min and np.ptp(tones[start : start + length]) > motion_min
    ]
    if stuck:
        start, length = max(stuck, key=lambda run: run[1])
        yield Finding(
            code="frozen",
            text=f"the output stays at exactly {scale * measured[start]:.6g} for {length} samples "
            "while the reference moves",
        )


def repeated_runs(measured: FloatArray) -> tuple[IndexArray, IndexArray]:
    """Return where the runs of identical samples begin, and how long they are; at least one."""
    starts = np.concatenate([[0], np.flatnonzero(np.diff(measured)) + 1])
    return starts, np.diff(np.concatenate([starts, [len(measured)]]))


def resolution_of(measured: FloatArray) -> float:
    """Return the least difference between samples that differ; 0 when none do."""
    levels = np.unique(measured)
    return float(np.min(np.diff(levels))) if len(levels) > 1 else 0.0


def _cut_off(
    measured: FloatArray, tones: FloatArray, starts: IndexArray, lengths: IndexArray
) -> list[float]:
    """Return the levels at which the sensor's range ends, at least twice, as far as it shows."""
    levels = measured[starts]
    usual = float(np.median(lengths))
    bounds = []
    for sign in (-1.0, 1.0):
        bound = sign * float(np.max(sign * levels))
        there = measured == bound
        runs = np.count_nonzero(levels == bound)
        inside = sign * float(np.max(sign * levels[levels != bound]))
        before = np.count_nonzero(measured == inside)
        often = np.count_nonzero(there) >= CUT_OFF_MIN_SAMPLES * usual
        alone = np.count_nonzero(there) > CUT_OFF_RATIO * before
        moved = np.ptp(tones[there]) > 2 * resolution_of(measured)
        if runs > 1 and often and alone and moved:
            bounds.append(bound)
    return bounds
