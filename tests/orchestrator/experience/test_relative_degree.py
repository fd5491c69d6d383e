"""The relative degree of a robot, from the steps that it made."""

from __future__ import annotations

import numpy as np
import pytest
from robots_that_learn import LaggedRobot
from scipy.signal import lfilter

from nufleet.orchestrator.experience.relative_degree import relative_degree
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import StudyError
from nufleet.shared.paths.references import step_references
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings


def measured(robot: Robot, column: int) -> int:
    references = step_references(robot.spec, column)
    return relative_degree(references[:, column], robot.run(references)[:, column])


@pytest.mark.parametrize("noise_std_m", [0.0, 0.002])
@pytest.mark.parametrize("delay", [1, 3, 8])
def test_the_relative_degree_of_a_delay_is_the_delay(delay: int, noise_std_m: float) -> None:
    robot = LaggedRobot((delay, 2), noise_std_m)
    assert measured(robot, 0) == delay
    assert measured(robot, 1) == 2


@pytest.mark.parametrize("sample_time_s", [0.001, 0.005, 0.1])
def test_steps_that_take_many_samples_or_one_show_the_same_delay(sample_time_s: float) -> None:
    """Two millimetres of noise, where one sample of acceleration moves 2 µm to 16 mm."""
    spec = LaggedRobot().spec.model_copy(
        update={"sample_time_s": sample_time_s, "settling_time_s": 4.0}
    )
    reference = step_references(spec, 0)[:, 0]
    delay = round(0.3 / sample_time_s)
    noise = 2e-3 * np.random.default_rng(0).standard_normal(len(reference))
    response = np.concatenate([np.zeros(delay), reference[:-delay]]) + noise
    measured_s = relative_degree(reference, response) * sample_time_s
    assert measured_s == pytest.approx(0.3, abs=max(0.02, sample_time_s / 2))


def test_what_is_left_of_one_step_is_no_answer_to_the_next() -> None:
    """After each hold 0.4 % of a step are still to come, eight times the noise."""
    spec = LaggedRobot().spec.model_copy(update={"settling_time_s": 3.0})
    reference = step_references(spec, 0)[:, 0]
    delay, pole = 10, float(np.exp(-spec.sample_time_s / 0.55))
    late = np.concatenate([np.zeros(delay), reference[:-delay]])
    response = lfilter([0.0, 1 - pole], [1.0, -pole], late)
    noise = 1e-4 * np.random.default_rng(0).standard_normal(len(reference))
    assert relative_degree(reference, response + noise) == pytest.approx(delay + 1, abs=3)


def test_the_relative_degree_of_section_v_is_one() -> None:
    """CB = αT²/2 ≠ 0: the output answers in the next sample."""
    robot = DoubleIntegrator(
        DoubleIntegratorSettings(alpha=0.85, beta=0.003), np.random.default_rng(0)
    )
    robot.connect()
    assert measured(robot, 0) == 1


@pytest.mark.parametrize("noise_std_m", [0.0, 1e-5])
@pytest.mark.parametrize("delay", [1, 4])
def test_a_robot_answers_from_the_sample_in_which_it_first_moves_the_wrong_way(
    delay: int, noise_std_m: float
) -> None:
    """It does so for two samples, in which a step within its acceleration limit is 1 mm high."""
    references = step_references(LaggedRobot().spec, 0)[:, 0]
    wrong_way = np.convolve(references, np.eye(delay + 1)[delay] * -0.3)[: len(references)]
    right_way = np.convolve(references, np.eye(delay + 3)[delay + 2] * 1.3)[: len(references)]
    noise = np.random.default_rng(0).normal(0.0, noise_std_m, len(references))
    assert relative_degree(references, wrong_way + right_way + noise) == delay


def test_a_robot_that_does_not_answer_has_no_relative_degree() -> None:
    with pytest.raises(StudyError, match="did not respond"):
        measured(LaggedRobot((10_000, 1), noise_std_m=0.001), 0)
