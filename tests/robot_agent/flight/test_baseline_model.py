"""From what a robot did on one path, what it would do on another."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest
from robots_that_learn import double_integrator

from nufleet.robot_agent.flight.baseline_model import (
    identify_baseline,
    needed_correction,
    samples_needed,
)
from nufleet.robot_agent.flight.rich_flight import rich_references
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import travel


@pytest.mark.parametrize("noise_std_m", [0.0, 0.002])
def test_it_predicts_the_baselines_error_on_a_path_it_never_saw(noise_std_m: float) -> None:
    robot = double_integrator(noise_std_m=noise_std_m)
    spec = robot.spec
    references = rich_references(spec, 60.0, np.random.default_rng(0))
    outputs = robot.run(references)
    robot.rest()
    record = (references[:, 0], outputs[:, 0])
    model = identify_baseline([record], spec.sample_time_s, 6.0)
    assert model.residual_std == pytest.approx(noise_std_m, rel=0.05, abs=2e-4)
    path = travel(np.array([[0.0], [0.9], [-0.4], [0.5]]), 0.8, 1.8, spec.sample_time_s)
    silent = double_integrator()
    made = (path - silent.run(path))[:, 0]
    error = model.error(path[:, 0]) - made
    assert np.sqrt(np.mean(error**2)) < 0.03 * np.sqrt(np.mean(made**2))


def test_where_the_path_is_does_not_matter() -> None:
    reference = np.random.default_rng(0).standard_normal(400).cumsum()
    model = identify_baseline([(reference, 0.5 * reference)], 0.02, 1.0)
    np.testing.assert_allclose(model.error(reference), model.error(reference + 5.0), atol=1e-9)


def test_too_little_to_learn_from_is_refused() -> None:
    short = np.zeros(30)
    with pytest.raises(InvalidInputError, match="too few"):
        identify_baseline([(short, short)], 0.02, 4.0)
    broken = np.full(4000, np.nan)
    with pytest.raises(InvalidInputError, match="not finite"):
        identify_baseline([(np.zeros(4000), broken)], 0.02, 4.0)


def test_the_correction_that_is_needed_takes_the_error_away() -> None:
    robot = double_integrator()
    spec = robot.spec
    references = rich_references(spec, 60.0, np.random.default_rng(0))
    outputs = robot.run(references)
    model = identify_baseline([(references[:, 0], outputs[:, 0])], spec.sample_time_s, 6.0)
    path = travel(np.array([[0.0], [0.9], [-0.5], [0.6], [0.0]]), 0.5, 1.0, spec.sample_time_s)
    robot.rest()
    before = path - robot.run(path)
    robot.rest()
    after = path - robot.run(path + needed_correction(model, path[:, 0])[:, np.newaxis])
    assert np.sqrt(np.mean(after**2)) < 0.3 * np.sqrt(np.mean(before**2))


def test_five_minutes_at_1_khz_are_fitted_in_a_few_mebibytes() -> None:
    """Beside the robot, whose computer may be small; all rows at once would take 0.4 GiB."""
    sample_time_s, samples, delay = 0.001, 300_000, 30
    rng = np.random.default_rng(0)
    reference = 1e-3 * np.cumsum(np.convolve(rng.standard_normal(samples), np.ones(200), "same"))
    noise = 1e-3 * rng.standard_normal(samples)
    output = np.concatenate([np.zeros(delay), reference[:-delay]]) + noise
    tracemalloc.start()
    try:
        model = identify_baseline([(reference, output)], sample_time_s, 6.0)
        _, peak_bytes = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak_bytes < 50 * 2**20
    assert model.residual_std < 0.05 * (reference - output).std()
    ramp = np.linspace(0.0, 1.0, 1001)
    assert model.error(ramp)[-1] == pytest.approx(delay * 1e-3, rel=0.02)


@pytest.mark.parametrize("settling_time_s", [0.0, 0.3, 2.0, 30.0])
def test_a_robot_of_one_sample_per_second_is_fitted_too(settling_time_s: float) -> None:
    needed = samples_needed(1.0, settling_time_s)
    reference = np.random.default_rng(0).standard_normal(needed).cumsum()
    output = np.concatenate([[reference[0]], reference[:-1]])
    model = identify_baseline([(reference, output)], 1.0, settling_time_s)
    np.testing.assert_allclose(model.error(reference), reference - output, atol=0.05)
    with pytest.raises(InvalidInputError, match="too few"):
        identify_baseline([(reference[:-1], output[:-1])], 1.0, settling_time_s)


def test_a_response_longer_than_a_model_holds_is_refused_in_words() -> None:
    with pytest.raises(InvalidInputError, match="a model of the baseline has at most 100000"):
        samples_needed(0.001, 120.0)
