"""A linear inverse is the linear relation in the data."""

from __future__ import annotations

import numpy as np

from nufleet.orchestrator.experience.linear_inverse import linear_experience
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.shared.experience.file import decode_experience, encode_experience
from nufleet.shared.experience.layout import InverseLayout

LAYOUT = InverseLayout(
    architecture="state", states=("position", "velocity"), sample_time_s=0.02, horizon_samples=5
)
ORIGIN = Origin("source-1", "quadrotor", ("x",), "m", 1)


def test_it_finds_the_relation_and_survives_storage() -> None:
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((500, 4)) * np.array([1.0, 10.0, 0.1, 1.0])
    gamma = inputs @ np.array([0.5, -0.2, 3.0, 1.0])
    experience = linear_experience(TrainingData(inputs, gamma), LAYOUT, ORIGIN)
    stored = decode_experience(encode_experience(experience))
    np.testing.assert_allclose(NetworkInverse(stored)(inputs), gamma, rtol=1e-2, atol=2e-3)
    assert stored.manifest.validation_rms < 2e-3


def test_a_gain_makes_it_as_much_too_eager() -> None:
    rng = np.random.default_rng(1)
    inputs = rng.standard_normal((100, 4))
    data = TrainingData(inputs, inputs[:, 0])
    plain, eager = (
        NetworkInverse(linear_experience(data, LAYOUT, ORIGIN, gain=gain)) for gain in (1.0, 1.25)
    )
    np.testing.assert_allclose(eager(inputs), 1.25 * plain(inputs), rtol=1e-5)
