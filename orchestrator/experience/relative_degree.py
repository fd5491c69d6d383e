"""Measures the delay of a robot in samples, its relative degree, from its responses to steps."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import StudyError

_NOISES = 5.0
"""Number of standard errors by which a response must exceed the noise to count as one."""


def relative_degree(reference: FloatArray, response: FloatArray) -> int:
    """Measure the number of samples after which an axis responds to a step of its reference.

    A step rises as quickly as the robot's acceleration allows, which takes many samples when the
    samples are short. The responses to all steps are averaged, each multiplied by the sign of its
    step. The delay is the time between two crossings of one threshold, five standard errors of the
    noise before the steps: that of the mean step, and that of the mean response, both interpolated
    between samples. For a robot that only delays its reference the result is exactly that delay,
    however slow the step. A response counts in either direction, because a robot with an unstable
    zero first moves the wrong way.

    Args:
        reference: Reference in the unit of the axis, shape (samples,): steps of equal height and
            shape, evenly spaced, each from one held level to the next.
        response: Output measured before each reference acted, in the same unit, shape (samples,).

    Returns:
        The delay in samples, at least 1.

    Raises:
        StudyError: Nothing responded before the next step.
    """
    # A step begins at its first sample that differs from the held level before; `ends` below are
    # the last samples that still differ from the one before.
    moves = np.diff(reference, prepend=reference[0]) != 0
    steps = np.flatnonzero(moves[1:] & ~moves[:-1]) + 1
    wait = int(np.diff(steps).min())
    window = steps[:, np.newaxis] + np.arange(min(wait, len(reference) - int(steps[-1])))
    asked = reference[window] - reference[steps - 1, np.newaxis]
    signs, height = np.sign(asked[:, -1:]), float(np.abs(asked[:, -1]).max())
    ends = np.flatnonzero(moves[:-1] & ~moves[1:])
    # The level before each step is an average over a 32nd of the shortest held stretch, directly
    # before the step, where the response to the previous step has settled most.
    held = int((steps[1:] - ends[: len(steps) - 1]).min())
    before = response[steps[:, np.newaxis] - 1 - np.arange(max(1, held // 32))]
    answers = (response[window] - before.mean(axis=1, keepdims=True)) * signs
    # The standard error at the step itself, where nothing can have responded yet. It covers the
    # noise and the remains of earlier steps, which enter with either sign equally often.
    error = answers[:, 0].std(ddof=1) / math.sqrt(len(steps))
    # The second term is for simulators without noise, whose standard error is only rounding.
    stands_out = np.abs(answers.mean(axis=0)) > _NOISES * error + 1e-9 * height
    if not stands_out.any():
        raise StudyError(f"the robot did not respond to steps of {height:g}")
    threshold = _NOISES * error + 1e-9 * height
    answered = _reached(np.abs(answers.mean(axis=0)), threshold)
    began = _reached((asked * signs).mean(axis=0), threshold)
    return max(1, round(answered - began))


def _reached(values: FloatArray, threshold: float) -> float:
    """Return where values first exceed a threshold, interpolated linearly between samples.

    The result counts samples from the first value; the value before that is taken to be 0.
    """
    k = int(np.argmax(values > threshold))
    before = values[k - 1] if k else 0.0
    return float(k - 1 + (threshold - before) / (values[k] - before))
