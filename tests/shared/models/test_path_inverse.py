"""The reference that puts a loop on a path that is known ahead."""

from __future__ import annotations

import numpy as np
import pytest
from test_error_belief import BASIS, LOOP, belief, evidence, played

from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import MODEL_ERROR, ErrorBelief, believe
from nufleet.shared.models.error_response import ErrorBasis
from nufleet.shared.models.path_inverse import inverted
from nufleet.shared.paths.trajectories import travel

PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.6]]), 0.8, 1.5, BASIS.sample_time_s)[:, 0]


def rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def test_the_inverse_of_an_exactly_known_loop_takes_nearly_all_of_its_error() -> None:
    """By an independent simulation of the closed loop; the baseline leaves 0.19 m."""
    known = believe(BASIS, evidence(1e-6))
    left = PATH - played(inverted(known, PATH), LOOP)
    assert rms(left) < 0.02 * rms(PATH - played(PATH))


def test_after_one_noisy_test_it_takes_nine_tenths() -> None:
    left = PATH - played(inverted(belief(), PATH))
    assert rms(left) < 0.1 * rms(PATH - played(PATH))


def test_a_pure_delay_is_inverted_by_looking_ahead() -> None:
    basis, delay = ErrorBasis(0.02, 0.5), 4
    mean = np.append((basis.nodes < delay).astype(np.float64), 0.0)
    known = ErrorBelief(basis, mean, np.zeros((basis.size, 1)), 0.0, 10.0)
    path = travel(np.array([[0.0], [0.6]]), 0.5, 1.0, 0.02)[:, 0]
    reference = inverted(known, path)
    # Linear between nodes two samples apart, the answer is known to half a sample.
    early = (reference[: -delay + 1], reference[1 : len(reference) - delay + 2])
    at = slice(delay - 1, None)
    left = [rms(part - path[at]) for part in early]
    assert min(left) < 0.15 * rms(path[delay:] - path[:-delay])


@pytest.mark.parametrize("omega_rad_s", [8.0, 15.0, 40.0, 100.0])
def test_nothing_is_amplified_beyond_what_a_linear_model_can_be_trusted_with(
    omega_rad_s: float,
) -> None:
    """|z*/(|z|² + v)| is at most 1/(2 √v), and v at least the square of the model's error."""
    time_s = np.arange(1000) * BASIS.sample_time_s
    fade = np.sin(np.pi * np.arange(1000) / 1000) ** 2
    fast = fade * np.sin(omega_rad_s * time_s)
    (z,), _ = belief().response(np.array([omega_rad_s]))
    most = 1 / (2 * MODEL_ERROR * abs(1 - z))
    assert rms(inverted(belief(), fast)) < 1.05 * most * rms(fast)


@pytest.mark.parametrize("place", [-1.0, 0.0, 2.0])
def test_where_the_path_is_does_not_matter_to_a_loop_that_rests_on_its_reference(
    place: float,
) -> None:
    mean = belief().mean.copy()
    mean[-1] = 0.0
    known = ErrorBelief(BASIS, mean, np.zeros((BASIS.size, 1)), 1e-3, 20.0)
    moved = inverted(known, PATH + place) - place
    np.testing.assert_allclose(moved, inverted(known, PATH), atol=1e-6)


def test_at_rest_the_reference_is_the_path() -> None:
    np.testing.assert_allclose(inverted(belief(), np.full(500, 0.7)), 0.7, rtol=0.02)
