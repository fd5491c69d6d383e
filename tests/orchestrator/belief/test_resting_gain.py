"""A loop probably rests where its reference is, unless its tests say otherwise."""

from __future__ import annotations

import numpy as np
import pytest
from test_response_belief import BAND, COMB, PRIOR, measured

from nufleet.orchestrator.belief.loop_features import response
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.belief.resting_gain import draw_resting
from nufleet.shared.arrays import FloatArray

SLOW = np.array([0.05, 0.1, 0.3])
"""Most of a drawing's motion: well below the tones of a first test."""


def loop(gain: float, rng: np.random.Generator) -> FloatArray:
    bandwidth, damping = rng.uniform(1.5, 5.0), rng.uniform(0.3, 1.0)
    return np.array([gain, rng.uniform(0.0, 1.0), np.log(bandwidth), np.log(damping), 0.1])


def off(gain: float, *, resting: bool) -> FloatArray:
    """Root mean square distances of samples from the truth at slow frequencies, for eight loops."""
    found = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        theta = loop(gain, rng)
        model = ResponseModel(measured(theta, COMB, 0.01, rng), PRIOR)
        draw = draw_resting if resting else ResponseModel.draw
        samples = draw(model, SLOW, 300, rng)
        found.append(np.sqrt(np.mean(np.abs(samples - response(theta, SLOW)) ** 2)))
    return np.array(found)


def test_a_loop_that_rests_on_its_reference_is_known_far_below_its_tones() -> None:
    """A metre-wide path's error of 3 % would be 30 mm: half of what a baseline leaves."""
    plain, resting = off(1.0, resting=False), off(1.0, resting=True)
    assert np.mean(resting) < 0.6 * np.mean(plain)
    assert np.max(resting) < 0.01


@pytest.mark.parametrize("gain", [0.7, 1.3])
def test_a_loop_whose_tests_say_that_it_does_not_is_believed_as_they_say(gain: float) -> None:
    """Half of such loops at least; the tests of some leave a gain of 1 possible."""
    assert np.median(off(gain, resting=True)) < 1.3 * np.median(off(gain, resting=False))


def test_the_samples_are_of_the_shape_that_was_asked_for() -> None:
    rng = np.random.default_rng(0)
    model = ResponseModel(measured(loop(1.0, rng), COMB, 0.01, rng), PRIOR)
    grid = np.linspace(*BAND, 9)
    assert draw_resting(model, grid, 40, rng).shape == (40, 9)
