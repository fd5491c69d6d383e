"""Faults of a sensor that show as runs of identical samples: frozen and clipped outputs."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from shared.arrays import FloatArray
from shared.response_quality import Finding

RUN_MIN_SAMPLES = 10
"""Shorter runs of identical samples are a matter of resolution, not a fault."""

RUN_MOTION_MIN = 0.02
"""A run is a fault when the output should have moved by this share of its range meanwhile."""


def sensor_faults(measured: FloatArray, tones: FloatArray, scale: float) -> Iterator[Finding]:
    """Yield what runs of identical samples say of the sensor.

    Args:
        measured: the output, shape (samples,).
        tones: the fitted tones alone, shape (samples,): how the output should have moved.
        scale: what 1 stands for in the axis's unit, for the text.
    """
    starts = np.concatenate([[0], np.flatnonzero(np.diff(measured)) + 1])
    lengths = np.diff(np.concatenate([starts, [len(measured)]]))
    if len(starts) == 1:
        yield Finding(
            code="frozen", text=f"the output stays at exactly {scale * measured[0]:.6g} throughout"
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
            text=f"the output is cut off at {' and '.join(f'{scale * b:.6g}' for b in bounds)} "
            f"({len(clipped)} times): a sensor or actuator saturates",
        )
    elif stuck:
        start, length = max(stuck, key=lambda run: run[1])
        yield Finding(
            code="frozen",
            text=f"the output stays at exactly {scale * measured[start]:.6g} for {length} samples "
            "while the reference moves",
        )
