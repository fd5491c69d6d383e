"""After how many samples a robot answers, from the steps that it made."""

from __future__ import annotations

import math

import numpy as np

from shared.arrays import FloatArray
from shared.errors import StudyError

_NOISES = 5.0
"""Standard errors that an answer must stand out by."""


def relative_degree(reference: FloatArray, response: FloatArray) -> int:
    """Measure after how many samples an axis answers to a step of its reference.

    The answers to all steps are averaged, each with its step's sign; the delay is that of the first
    mean that leaves the noise before the steps by five standard errors, in either direction: a
    robot with an unstable zero first moves the wrong way.

    Args:
        reference: steps of one height, evenly spaced, shape (samples,).
        response: the output measured before each reference acted, shape (samples,).

    Raises:
        StudyError: nothing answered before the next step.
    """
    steps = np.flatnonzero(np.diff(reference)) + 1
    wait = int(np.diff(steps).min())
    change = np.diff(reference)[steps - 1]
    signs, height = np.sign(change), float(np.abs(change).max())
    window = steps[:, np.newaxis] + np.arange(min(wait, len(reference) - int(steps[-1])))
    answers = (response[window] - response[steps - 1, np.newaxis]) * signs[:, np.newaxis]
    error = answers[:, 0].std(ddof=1) / math.sqrt(len(steps))
    stands_out = np.abs(answers.mean(axis=0)) > _NOISES * error + 1e-9 * height
    if not stands_out.any():
        raise StudyError(f"the robot did not answer to steps of {height:g}")
    return max(1, int(np.argmax(stands_out)))
