"""Samples of a response whose loop probably comes to rest where its reference is.

No test plays a tone of 0 rad/s, and tones at the upper end of a band leave the gain at rest open by
several percent: as much as a metre-wide path's whole error. Yet nearly every position controller
rests where its reference is, as it shows between any two motions.
"""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.shared.arrays import ComplexArray

RESTING_STD = 0.01
"""Standard deviation of the gain at rest about 1, of a loop that rests where its reference is."""

RESTING_PROBABILITY = 0.7
"""Prior probability that a loop does."""

_OVERSAMPLING = 6


def draw_resting(
    model: ResponseModel, omega_rad_s: np.ndarray, count: int, rng: np.random.Generator
) -> ComplexArray:
    """Draw samples of a response, given that its loop probably rests where its reference is.

    The samples of the model are weighted with the ratio of the two prior densities of z(0), and
    drawn again with these weights (sampling-importance resampling: Rubin, 1988). Where the tests
    speak against a gain of 1, the samples stay what they are.

    Args:
        model: Belief about the response, which leaves the gain at rest open.
        omega_rad_s: Frequencies in rad/s, shape (frequencies,).
        count: Number of samples.
        rng: Generator that draws them.

    Returns:
        Samples of z, shape (count, frequencies).
    """
    at = np.concatenate([[0.0], omega_rad_s])
    samples = model.draw(at, _OVERSAMPLING * count, rng)
    off = samples[:, 0].real - 1.0
    wide = model.gain_std
    ratio = np.exp(0.5 * (off / wide) ** 2 - 0.5 * (off / RESTING_STD) ** 2) * wide / RESTING_STD
    weights = RESTING_PROBABILITY * ratio + 1.0 - RESTING_PROBABILITY
    chosen = rng.choice(len(samples), size=count, p=weights / weights.sum())
    return samples[chosen, 1:]
