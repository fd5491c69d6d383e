"""The simulated robot of Section V does what its state equation says."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pydantic import ValidationError
from scipy.signal import dlsim

from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.sims.double_integrator import (
    DoubleIntegrator,
    DoubleIntegratorSettings,
    closed_loop,
    slowest_pole,
)

SECTION_V = [(0.85, 0.003), (1.0, 0.003), (0.97, 0.004), (0.9, 0.001)]


def robot_with(
    alpha: float = 0.85, beta: float = 0.003, noise_std_m: float = 0.0, seed: int = 0
) -> DoubleIntegrator:
    chosen = DoubleIntegratorSettings(alpha=alpha, beta=beta, noise_std_m=noise_std_m)
    robot = DoubleIntegrator(chosen, np.random.default_rng(seed))
    robot.connect()
    return robot


def random_reference(samples: int, seed: int = 1) -> FloatArray:
    return np.random.default_rng(seed).standard_normal((samples, 1))


@pytest.mark.parametrize(("alpha", "beta"), SECTION_V)
def test_the_robot_follows_the_printed_state_equation(alpha: float, beta: float) -> None:
    references = random_reference(300)
    a = np.array([[1.0, 0.015 - beta], [0.0, 1.0 - beta]])
    b = alpha * np.array([0.5 * 0.015**2, 0.015])
    x, last_error, expected = np.zeros(2), 0.0, []
    for y_r in references[:, 0]:
        expected.append(x[0])
        error = y_r - x[0]
        x = a @ x + b * (5.0 * error + 4.5 * (error - last_error) / 0.015)
        last_error = error
    measured = robot_with(alpha, beta).run(references)
    np.testing.assert_allclose(measured[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize(("alpha", "beta"), SECTION_V)
def test_the_model_in_its_spec_is_the_loop_it_runs(alpha: float, beta: float) -> None:
    robot = robot_with(alpha, beta)
    model = robot.spec.axis("x").model
    assert model is not None
    references = random_reference(500)
    b, c = np.array(model.b)[:, None], np.array(model.c)[None]
    system = (np.array(model.a), b, c, np.zeros((1, 1)), 0.015)
    _, expected, _ = dlsim(system, references)
    np.testing.assert_allclose(robot.run(references), expected, atol=1e-11)


@given(st.integers(1, 60), st.floats(0.0, 0.1))
@settings(max_examples=30, deadline=None)
def test_running_a_signal_is_the_same_as_stepping_through_it(
    samples: int, noise_std_m: float
) -> None:
    references = random_reference(samples)
    at_once = robot_with(noise_std_m=noise_std_m).run(references)
    stepping = robot_with(noise_std_m=noise_std_m)
    one_by_one = np.array([stepping.step(reference) for reference in references])
    np.testing.assert_allclose(at_once, one_by_one, rtol=0, atol=1e-12)


def test_an_output_is_measured_before_its_reference_acts() -> None:
    robot = robot_with()
    outputs = [robot.step(np.array([1.0]))[0] for _ in range(2)]
    assert outputs[0] == 0.0
    assert outputs[1] == pytest.approx(0.85 * 0.015**2 / 2 * (5.0 + 4.5 / 0.015))


def test_noise_has_the_standard_deviation_asked_for_and_follows_the_generator() -> None:
    still = np.zeros((20_000, 1))
    noise = robot_with(noise_std_m=0.01).run(still)[:, 0]
    # The controller reacts to the noise, but only at its bandwidth of a few rad/s.
    assert np.std(noise) == pytest.approx(0.01, rel=0.05)
    np.testing.assert_array_equal(noise, robot_with(noise_std_m=0.01).run(still)[:, 0])
    assert not np.array_equal(noise, robot_with(noise_std_m=0.01, seed=1).run(still)[:, 0])


def test_the_controller_acts_on_the_measured_output() -> None:
    # Shifting reference and sensor alike shifts the measured output and nothing else.
    noise = 0.01 * np.random.default_rng(0).standard_normal(400)
    measured = robot_with(noise_std_m=0.01).run(np.zeros((400, 1)))[:, 0]
    moved = robot_with().run(-noise[:, None])[:, 0]
    np.testing.assert_allclose(measured, moved + noise, atol=1e-12)


@pytest.mark.parametrize("noise_std_m", [0.0, 0.002])
def test_rest_brings_a_moving_robot_to_zero(noise_std_m: float) -> None:
    robot = robot_with(noise_std_m=noise_std_m)
    robot.run(np.ones((200, 1)))
    robot.rest()
    still = robot.run(np.zeros((100, 1)))
    assert np.max(np.abs(still)) < 1e-5 + 6 * noise_std_m


def test_after_the_settling_time_a_step_response_has_settled() -> None:
    robot = robot_with()
    samples = round(robot.spec.settling_time_s / robot.spec.sample_time_s)
    response = robot.run(np.ones((samples + 3000, 1)))[:, 0]
    assert np.max(np.abs(response[samples:] - response[-1])) < 1e-3
    assert np.max(np.abs(response[: samples // 4] - response[-1])) > 1e-2


@pytest.mark.parametrize(("alpha", "beta"), SECTION_V)
def test_settling_is_the_time_in_which_the_slowest_mode_decays_to_one_in_ten_thousand(
    alpha: float, beta: float
) -> None:
    robot = robot_with(alpha, beta)
    pole = slowest_pole(closed_loop(DoubleIntegratorSettings(alpha=alpha, beta=beta)))
    decays = pole ** (robot.spec.settling_time_s / 0.015)
    assert 1e-4 * pole < decays <= 1e-4 * (1 + 1e-9)


def test_a_robot_that_is_not_connected_says_so() -> None:
    robot = robot_with()
    robot.disconnect()
    robot.disconnect()
    for call in (lambda: robot.step(np.zeros(1)), robot.rest):
        with pytest.raises(RobotError, match="not connected"):
            call()
    robot.connect()
    assert robot.step(np.zeros(1)) == 0.0


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_reference_that_is_not_finite_is_an_error_and_moves_nothing(bad: float) -> None:
    robot = robot_with()
    with pytest.raises(RobotError, match="not finite"):
        robot.run(np.array([[1.0], [bad]]))
    assert robot.step(np.zeros(1)) == 0.0


def test_parameters_that_make_the_loop_unstable_are_refused() -> None:
    with pytest.raises(ValidationError, match="not stable"):
        DoubleIntegratorSettings(alpha=1.0, beta=0.003, k_p=1000.0, k_d=0.0)


def test_observing_shows_the_output_that_the_next_step_returns_and_changes_nothing() -> None:
    observed, left_alone = robot_with(noise_std_m=0.01), robot_with(noise_std_m=0.01)
    for reference in random_reference(20):
        first, again = observed.observe(), observed.observe()
        np.testing.assert_array_equal(first, again)
        output = observed.step(reference)
        assert first[0, 0] == output[0]
        np.testing.assert_array_equal(output, left_alone.step(reference))
    assert observed.state_names == ("position", "velocity")
    seen, rest = observed.observe()[0, 0], random_reference(5)
    outputs = observed.run(rest)
    assert outputs[0, 0] == seen
    np.testing.assert_array_equal(outputs, left_alone.run(rest))


def test_states_observed_on_the_way_are_those_observed_between_two_runs() -> None:
    references, observed = random_reference(90), (0, 1, 2, 64, 89)
    at_once, in_parts = robot_with(noise_std_m=0.01), robot_with(noise_std_m=0.01)
    outputs, states = at_once.run_observed(references, observed)
    expected = Robot.run_observed(in_parts, references, observed)
    np.testing.assert_array_equal(outputs, expected[0])
    np.testing.assert_array_equal(states, expected[1])
    np.testing.assert_array_equal(at_once.observe(), in_parts.observe())


def test_the_observed_speed_is_the_rate_of_the_position() -> None:
    robot = robot_with(beta=0.0)
    robot.run(np.ones((40, 1)))
    before = robot.observe()[0]
    robot.step(np.ones(1))
    after = robot.observe()[0]
    assert after[0] - before[0] == pytest.approx(0.015 * (before[1] + after[1]) / 2, rel=1e-9)
