"""The feedback answers what the references do not explain, and that alone."""

from __future__ import annotations

import numpy as np

from nufleet.robot_agent.flight.output_feedback import FeedbackLoop, OutputFeedback

RESPONSE = np.array([0.5, 0.3, 0.2])
"""An output that follows its reference within three samples."""

TAPS = np.array([-0.6, -0.2])
START = np.array([0.4])


def corrections(push: np.ndarray, references: np.ndarray) -> np.ndarray:
    """Return what the feedback adds at each sample to references that were sent, with a push."""
    moved = references - START
    outputs = START + np.convolve(moved[:, 0], np.append(0.0, RESPONSE))[: len(push), None]
    loop = FeedbackLoop(OutputFeedback((RESPONSE,), (TAPS,)), START, len(push))
    found = [
        loop.correction(k, references[k - 1], outputs[k - 1] + push[k - 1])
        for k in range(1, len(push))
    ]
    return np.concatenate([[0.0], np.concatenate(found)])


def test_a_loop_that_does_what_its_model_says_is_left_alone_whatever_it_was_sent() -> None:
    """Also where a limit or the guard changed the reference that was wished for."""
    sent = START + np.random.default_rng(0).standard_normal((50, 1))
    np.testing.assert_allclose(corrections(np.zeros(50), sent), 0.0, atol=1e-12)


def test_what_is_measured_beyond_the_expected_is_filtered() -> None:
    sent = START + np.random.default_rng(1).standard_normal((20, 1))
    push = np.zeros(20)
    push[7] = 0.01
    expected = np.zeros(20)
    expected[8:10] = 0.01 * TAPS
    np.testing.assert_allclose(corrections(push, sent), expected, atol=1e-12)
