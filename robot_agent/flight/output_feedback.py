"""Corrects a flight by what the robot measures beyond what its references explain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.shared.arrays import FloatArray


@dataclass(frozen=True, eq=False)
class OutputFeedback:
    """A model of the loop, and a filter of what it does not explain, for each axis."""

    responses: tuple[FloatArray, ...]
    """Impulse response of each axis: the output 1, 2, … samples after the reference acted, shape
    (memory,), without unit."""
    taps: tuple[FloatArray, ...]
    """Weights in the correction of what was measured beyond the expected 1, 2, … samples ago, shape
    (taps,), without unit."""


class FeedbackLoop:
    """The feedback during one flight; its time per sample grows with the memory of the loop."""

    def __init__(self, feedback: OutputFeedback, start: FloatArray, samples: int) -> None:
        """Begin at rest.

        Args:
            feedback: Model and filter.
            start: Reference at which the robot rests, shape (axes,), in the axes' units.
            samples: Number of samples of the flight.
        """
        self._feedback, self._start = feedback, start
        self._moved = np.zeros((samples, len(start)))
        self._beyond = np.zeros((samples, len(start)))

    def correction(self, sample: int, reference: FloatArray, output: FloatArray) -> FloatArray:
        """Return the correction of a sample, shape (axes,); to be called for each one, in order.

        Args:
            sample: Index of the sample, from 1; nothing is known at the first.
            reference: Reference sent for the sample before, shape (axes,), in the axes' units.
            output: Output measured before that reference acted, shape (axes,).
        """
        past = sample - 1
        self._moved[past] = reference - self._start
        found = np.empty_like(self._start)
        for i, (response, taps) in enumerate(
            zip(self._feedback.responses, self._feedback.taps, strict=True)
        ):
            # The output of a sample answers the references before it.
            sent = self._moved[max(0, past - len(response)) : past, i][::-1]
            expected = self._start[i] + sent @ response[: len(sent)]
            self._beyond[past, i] = output[i] - expected
            recent = self._beyond[max(0, sample - len(taps)) : sample, i][::-1]
            found[i] = recent @ taps[: len(recent)]
        return found
