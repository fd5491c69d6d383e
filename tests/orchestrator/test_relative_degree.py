"""The relative degree of a robot, from the steps that it made."""

from __future__ import annotations

import numpy as np
import pytest
from robots_that_learn import LaggedRobot

from orchestrator.relative_degree import relative_degree
from robot_agent.rich_flight import step_references
from robot_agent.robot import Robot
from shared.errors import StudyError
from sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings


def measured(robot: Robot, column: int) -> int:
    references = step_references(robot.spec, column)
    return relative_degree(references[:, column], robot.run(references)[:, column])


@pytest.mark.parametrize("noise_std_m", [0.0, 0.002])
@pytest.mark.parametrize("delay", [1, 3, 8])
def test_the_relative_degree_of_a_delay_is_the_delay(delay: int, noise_std_m: float) -> None:
    robot = LaggedRobot((delay, 2), noise_std_m)
    assert measured(robot, 0) == delay
    assert measured(robot, 1) == 2


def test_the_relative_degree_of_section_v_is_one() -> None:
    """CB = αT²/2 ≠ 0: the output answers in the next sample."""
    robot = DoubleIntegrator(
        DoubleIntegratorSettings(alpha=0.85, beta=0.003), np.random.default_rng(0)
    )
    robot.connect()
    assert measured(robot, 0) == 1


@pytest.mark.parametrize("noise_std_m", [0.0, 0.001])
@pytest.mark.parametrize("delay", [1, 4])
def test_a_robot_answers_from_the_sample_in_which_it_first_moves_the_wrong_way(
    delay: int, noise_std_m: float
) -> None:
    references = step_references(LaggedRobot().spec, 0)[:, 0]
    wrong_way = np.convolve(references, np.eye(delay + 1)[delay] * -0.3)[: len(references)]
    right_way = np.convolve(references, np.eye(delay + 3)[delay + 2] * 1.3)[: len(references)]
    noise = np.random.default_rng(0).normal(0.0, noise_std_m, len(references))
    assert relative_degree(references, wrong_way + right_way + noise) == delay


def test_a_robot_that_does_not_answer_has_no_relative_degree() -> None:
    with pytest.raises(StudyError, match="did not answer"):
        measured(LaggedRobot((10_000, 1), noise_std_m=0.001), 0)
