"""After how many samples a robot answers, from the steps that it made."""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import StudyError

_NOISES = 5.0
"""Standard errors that an answer must stand out by."""


def relative_degree(reference: FloatArray, response: FloatArray) -> int:
    """Measure after how many samples an axis answers to a step of its reference.

    Robots step as quickly as their acceleration allows, which takes many samples where these are
    short. The answers to all steps are averaged, each with its sign. The delay is the time from
    where the mean step itself reaches five standard errors of the noise before the steps to where
    the mean answer does, interpolated between samples: for a robot that only delays its reference
    exactly the delay, however slow the step. An answer counts in either direction: a robot with an
    unstable zero first moves the wrong way.

    Args:
        reference: steps of one height and shape, evenly spaced, each from a held level to the
            next, shape (samples,).
        response: the output measured before each reference acted, shape (samples,).

    Raises:
        StudyError: nothing answered before the next step.
    """
    moves = np.diff(reference, prepend=reference[0]) != 0
    steps = np.flatnonzero(moves[1:] & ~moves[:-1]) + 1
    wait = int(np.diff(steps).min())
    window = steps[:, np.newaxis] + np.arange(min(wait, len(reference) - int(steps[-1])))
    asked = reference[window] - reference[steps - 1, np.newaxis]
    signs, height = np.sign(asked[:, -1:]), float(np.abs(asked[:, -1]).max())
    ends = np.flatnonzero(moves[:-1] & ~moves[1:])
    held = int((steps[1:] - ends[: len(steps) - 1]).min())
    before = response[steps[:, np.newaxis] - 1 - np.arange(max(1, held // 32))]
    answers = (response[window] - before.mean(axis=1, keepdims=True)) * signs
    # Of the noise, and of what is left of the steps before: that has either sign alike.
    error = answers[:, 0].std(ddof=1) / math.sqrt(len(steps))
    stands_out = np.abs(answers.mean(axis=0)) > _NOISES * error + 1e-9 * height
    if not stands_out.any():
        raise StudyError(f"the robot did not answer to steps of {height:g}")
    threshold = _NOISES * error + 1e-9 * height
    answered = _reached(np.abs(answers.mean(axis=0)), threshold)
    began = _reached((asked * signs).mean(axis=0), threshold)
    return max(1, round(answered - began))


def _reached(values: FloatArray, threshold: float) -> float:
    """Return when values, 0 before the first, first exceed a threshold, in samples from it."""
    k = int(np.argmax(values > threshold))
    before = values[k - 1] if k else 0.0
    return float(k - 1 + (threshold - before) / (values[k] - before))
