"""Notices a sensor that lags: an output that moves long after its reference.

A noisy, slow or lightly damped robot is not late in this sense, nor one with friction or a dead
zone, which moves before its reference has covered its whole range.
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray

LAG_SHARE = 0.8
LAG_SETTLINGS = 2.0
LAG_RATIO = 10.0
LAG_SAMPLES = 5
"""A sensor lags if the output stays at rest until its reference has covered `LAG_SHARE` of its
range and `LAG_SETTLINGS` settling times have passed, and then moves: `LAG_RATIO` times as far as
until then, in `LAG_SAMPLES` samples in a row."""


class LagWatch:
    """Watches one axis during one motion."""

    def __init__(self, rests_at: float, span: float, settling: int) -> None:
        """Begin at rest.

        Args:
            rests_at: Output at rest.
            span: Largest minus smallest reference of the motion; 0 for an axis that holds its own.
            settling: Number of samples in which the robot settles.
        """
        self._rests_at = rests_at
        self._reach = LAG_SHARE * span if span > 0 else math.inf
        self._left = math.ceil(LAG_SETTLINGS * settling)
        self._low = self._high = 0.0
        self._moved = 0.0
        self._late = 0
        self._began = -1
        self._sample = -1

    def none_in(self, references: FloatArray, outputs: FloatArray) -> bool:
        """Return whether a batch needs no closer look; if so, it is taken."""
        if math.isinf(self._reach):
            return True
        away = np.abs(outputs - self._rests_at)
        # From the first covered sample on, the output may stay at rest for `_left` samples.
        covered = self._first_covered(references)
        resting = min(len(away), covered + self._left) if self._left else 0
        moved = max(self._moved, float(away[:resting].max(initial=0.0)))
        if resting < len(away):
            if away[resting:].max() > LAG_RATIO * moved:
                return False
            self._late = 0
        self._moved = moved
        self._left -= max(0, resting - covered)
        self._low = min(self._low, float(references.min()))
        self._high = max(self._high, float(references.max()))
        if self._began < 0 and references.any():
            self._began = self._sample + 1 + int(np.argmax(references != 0.0))
        self._sample += len(outputs)
        return True

    def _first_covered(self, references: FloatArray) -> int:
        """Return by which sample of a batch its reference has covered enough; its length if none.

        Enough is `LAG_SHARE` of its range.
        """
        if self._high - self._low >= self._reach:
            return 0
        highest = np.maximum(np.maximum.accumulate(references), self._high)
        lowest = np.minimum(np.minimum.accumulate(references), self._low)
        covered = highest - lowest >= self._reach
        return int(np.argmax(covered)) if covered[-1] else len(references)

    def take(self, reference: float, output: float) -> int | None:
        """Take a sample; return by how many the output is late, once it is certain that it is."""
        self._sample += 1
        self._low, self._high = min(self._low, reference), max(self._high, reference)
        if self._began < 0 and reference != 0.0:
            self._began = self._sample
        away = abs(output - self._rests_at)
        if self._left > 0:
            self._moved = max(self._moved, away)
            self._left -= self._high - self._low >= self._reach
            return None
        self._late = self._late + 1 if away > LAG_RATIO * self._moved else 0
        return self._sample - self._began if self._late == LAG_SAMPLES else None
