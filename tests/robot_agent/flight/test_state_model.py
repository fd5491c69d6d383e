"""How states follow from the output is found from few observations, noise or not."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.robot_agent.flight.state_model import StateEvidence, state_evidence, state_model
from nufleet.shared.arrays import FloatArray

NAMES = ("position", "velocity", "tilt")
STEP_S = 0.02


def motion(samples: int = 1500, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Outputs with 1 mm of noise, and states of which three in 64 were observed."""
    rng = np.random.default_rng(seed)
    omegas, phases = np.array([0.9, 2.1, 4.4]), rng.uniform(0, 2 * np.pi, 3)
    angles = np.outer(np.arange(samples) * STEP_S, omegas) + phases
    position = 0.2 * np.sin(angles).sum(axis=1)
    velocity, acceleration = 0.2 * np.cos(angles) @ omegas, -0.2 * np.sin(angles) @ omegas**2
    states = np.stack([position, velocity, 0.1 * acceleration], axis=1)
    states += rng.standard_normal(states.shape) * [1e-3, 1e-2, 5e-3]
    outputs = states[:, 0].copy()
    states[np.arange(samples) % 64 > 2] = np.nan
    return outputs, states


def seen(seed: int = 0, samples: int = 1500) -> StateEvidence:
    found = state_evidence(NAMES, *motion(samples, seed), STEP_S, 4.4)
    assert found is not None
    return found


def test_a_velocity_and_a_tilt_are_told_from_two_dozen_observations() -> None:
    found = state_model(NAMES, {"x": seen()}, ["x"], [1e-3])
    assert found.names == NAMES
    np.testing.assert_allclose(found.gains[0, 1], [1.0, 0.0], atol=0.03)
    np.testing.assert_allclose(found.gains[0, 2], [0.0, 0.1], atol=0.01)
    np.testing.assert_allclose(found.noise_std[0], [0.0, 1e-2, 5e-3], rtol=0.3)


def test_evidence_of_several_motions_adds_up() -> None:
    whole = seen() + seen(seed=1)
    assert whole.observations == seen().observations + seen(seed=1).observations
    once, twice = (state_model(NAMES, {"x": each}, ["x"], [1e-3]) for each in (seen(), whole))
    exact = np.array([0.0, 0.1])
    assert np.abs(twice.gains[0, 2] - exact).max() <= 1.5 * np.abs(once.gains[0, 2] - exact).max()


def test_a_robot_with_other_states_than_before_is_learned_anew() -> None:
    outputs, states = motion()
    other = state_evidence(("position", "speed"), outputs, states[:, :2], STEP_S, 4.4)
    assert other is not None
    assert (seen() + other).names == ("speed",)


def test_an_axis_that_was_not_observed_is_like_the_others() -> None:
    found = state_model(NAMES, {"x": seen()}, ["x", "y"], [1e-3, 1e-3])
    np.testing.assert_array_equal(found.gains[0], found.gains[1])


def test_a_velocity_needs_no_observation_and_any_other_state_does() -> None:
    found = state_model(NAMES, {}, ["x"], [1e-3])
    assert found.names == ("position", "velocity")
    np.testing.assert_array_equal(found.gains[0, 1], [1.0, 0.0])
    assert found.noise_std[0, 1] == pytest.approx(1e-2)
    assert state_model(("position", "tilt", "velocity"), {}, ["x"], [1e-3]).names == ("position",)


def test_a_short_motion_or_one_without_states_shows_nothing() -> None:
    outputs, states = motion(64)
    assert state_evidence(NAMES, outputs, states, STEP_S, 4.4) is None
    assert state_evidence(NAMES[:1], outputs, states[:, :1], STEP_S, 4.4) is None
