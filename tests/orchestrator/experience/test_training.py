"""Training is repeatable, learns, and agrees with what the robot computes."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch

from nufleet.orchestrator.experience.training import Origin, TrainingData, train
from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.file import Experience, decode_experience, encode_experience
from nufleet.shared.experience.layout import InverseLayout

LAYOUT = InverseLayout(
    architecture="state", states=("position", "velocity"), sample_time_s=0.02, horizon_samples=5
)
ORIGIN = Origin("source-1", "quadrotor", ("x", "y"), "m", 3)


def data(samples: int = 1500) -> TrainingData:
    rng = np.random.default_rng(0)
    inputs = rng.uniform(-1, 1, (samples, 4)) * np.array([1.0, 0.1, 5.0, 1.0]) + 3.0
    gamma = np.sin(inputs[:, 0]) + 4 * inputs[:, 1] + 0.05 * inputs[:, 2] ** 2
    return TrainingData(inputs, gamma + 0.01 * rng.standard_normal(samples))


def trained(seed: int = 0) -> Experience:
    return train(data(), LAYOUT, ORIGIN, seed=seed, points=1000, steps_max=300)


@pytest.fixture(scope="module")
def experience() -> Experience:
    return trained()


def test_the_same_data_and_seed_give_the_same_bytes(experience: Experience) -> None:
    assert encode_experience(trained()) == encode_experience(experience)
    assert encode_experience(trained(seed=1)) != encode_experience(experience)


def test_it_learns_points_it_was_not_trained_on(experience: Experience) -> None:
    fresh = data(3000)
    inputs, gamma = fresh.inputs[1500:], fresh.gamma[1500:]
    left = NetworkInverse(experience)(inputs) - gamma
    assert left.std() < 0.1 * gamma.std()
    assert experience.manifest.validation_rms == pytest.approx(left.std(), rel=0.35)


def test_the_robot_computes_what_torch_computes(experience: Experience) -> None:
    manifest, inputs = experience.manifest, data().inputs[:50]
    activity = torch.tensor((inputs - manifest.input_mean) / np.array(manifest.input_scale))
    layers = len(manifest.hidden) + 1
    for i in range(layers):
        weight, bias = (
            torch.tensor(experience.arrays[f"{kind}_{i}"]).double() for kind in ("weight", "bias")
        )
        activity = torch.nn.functional.linear(activity, weight.T, bias)
        activity = torch.relu(activity) if i < layers - 1 else activity
    expected = activity[:, 0].numpy() * manifest.output_scale + manifest.output_mean
    np.testing.assert_allclose(NetworkInverse(experience)(inputs), expected, rtol=1e-9)


def test_the_manifest_says_what_was_trained(experience: Experience) -> None:
    manifest = experience.manifest
    assert manifest.hidden == (128, 128, 128, 128)
    assert (manifest.points, manifest.seed, manifest.relative_degree) == (1000, 0, 3)
    assert (manifest.robot, manifest.axes, manifest.inputs) == (
        "source-1",
        ("x", "y"),
        LAYOUT.input_names,
    )
    assert decode_experience(encode_experience(experience)).manifest == manifest


def linear_data(unexplained: float) -> TrainingData:
    """Pairs of a linear inverse, and a share of γ that no linear inverse explains."""
    rng = np.random.default_rng(3)
    inputs = rng.standard_normal((1500, 4))
    gamma = inputs @ np.array([0.3, -1.0, 2.0, 0.1]) + 0.7
    return TrainingData(inputs, gamma + unexplained * gamma.std() * rng.standard_normal(1500))


def test_a_network_that_is_not_trained_is_the_linear_inverse() -> None:
    pairs = linear_data(unexplained=0.02)
    told: list[tuple[int, int]] = []

    def stepped(done: int, most: int) -> None:
        told.append((done, most))

    experience = train(pairs, LAYOUT, ORIGIN, seed=0, points=1000, steps_max=0, stepped=stepped)
    assert told[-1] == (0, 0)
    assert experience.manifest.hidden == (128, 128, 128, 128)
    exact = linear_data(unexplained=0.0)
    np.testing.assert_allclose(NetworkInverse(experience)(exact.inputs), exact.gamma, atol=0.02)


def test_where_a_linear_inverse_explains_all_it_is_the_experience_and_no_network_is_trained(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    pairs = linear_data(unexplained=0.005)
    monkeypatch.setitem(sys.modules, "torch", None)  # any import of it fails
    experience = train(pairs, LAYOUT, ORIGIN, seed=0, points=1000)
    manifest = experience.manifest
    assert manifest.hidden == ()
    left = NetworkInverse(experience)(pairs.inputs) - pairs.gamma
    assert manifest.validation_rms == pytest.approx(left.std(), rel=0.2)
    assert left.std() < 0.01 * pairs.gamma.std()
    assert decode_experience(encode_experience(experience)).manifest == manifest


def test_several_at_once_are_trained_as_one_alone(experience: Experience) -> None:
    with ThreadPoolExecutor(3) as pool:
        for other in pool.map(trained, [0, 0, 0]):
            assert encode_experience(other) == encode_experience(experience)


def test_torchs_own_generator_is_left_as_it_was() -> None:
    state = torch.random.get_rng_state()
    trained()
    assert torch.equal(torch.random.get_rng_state(), state)


def test_data_that_cannot_be_learned_from_are_refused() -> None:
    good = data()
    still = np.ones_like(good.inputs)
    for inputs, gamma, message in [
        (good.inputs[:900], good.gamma[:900], "let the robot fly for longer"),
        (np.where(good.inputs > 7, np.nan, good.inputs), good.gamma, "not finite"),
        (still, good.gamma, "do not vary"),
        (good.inputs, np.zeros_like(good.gamma), "do not vary"),
    ]:
        with pytest.raises(InvalidInputError, match=message):
            train(TrainingData(inputs, gamma), LAYOUT, ORIGIN, seed=0, points=1000)
