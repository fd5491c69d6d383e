"""Rich references keep to the limits and show the dynamics; steps show the relative degree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from robots_that_learn import LaggedRobot, double_integrator

from robot_agent.rich_flight import fly_record, relative_degree, rich_references
from shared.errors import RobotError


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_references_keep_to_every_limit_and_reach_one(seed: int) -> None:
    spec = LaggedRobot().spec
    references = rich_references(spec, spec.axes, 60.0, np.random.default_rng(seed))
    assert len(references) * spec.sample_time_s >= 60.0
    axis = spec.axes[0]
    position = np.abs(references) / axis.amplitude_max
    speed = np.abs(np.diff(references, axis=0)) / spec.sample_time_s / axis.velocity_max
    pull = np.abs(np.diff(references, 2, axis=0)) / spec.sample_time_s**2 / axis.acceleration_max
    largest = [float(share.max()) for share in (position, speed, pull)]
    assert max(largest) <= 1.02
    assert max(largest) >= 0.99
    np.testing.assert_allclose(references[[0, -1]], 0.0, atol=1e-9)


def test_the_same_generator_gives_the_same_references() -> None:
    spec = LaggedRobot().spec
    first, again = (
        rich_references(spec, spec.axes, 60.0, np.random.default_rng(3)) for _ in range(2)
    )
    np.testing.assert_array_equal(first, again)


def test_a_record_holds_the_state_before_each_reference_acted() -> None:
    robot = LaggedRobot((3, 5))
    references = np.random.default_rng(0).standard_normal((40, 2))
    record = fly_record(robot, references)
    np.testing.assert_array_equal(record.states[3:, 0, 0], references[:-3, 0])
    np.testing.assert_array_equal(record.states[5:, 1, 0], references[:-5, 1])
    assert robot.rests == 1


def test_a_sensor_that_measures_nan_gives_no_record() -> None:
    with pytest.raises(RobotError, match="not finite"):
        fly_record(LaggedRobot(blind_at=7), np.zeros((20, 2)))


@pytest.mark.parametrize("noise_std_m", [0.0, 0.002])
@pytest.mark.parametrize("delay", [1, 3, 8])
def test_the_relative_degree_of_a_delay_is_the_delay(delay: int, noise_std_m: float) -> None:
    robot = LaggedRobot((delay, 2), noise_std_m)
    assert relative_degree(robot, 0) == delay
    assert relative_degree(robot, 1) == 2


def test_the_relative_degree_of_section_v_is_one() -> None:
    """CB = αT²/2 ≠ 0: the output answers in the next sample."""
    assert relative_degree(double_integrator(), 0) == 1


def test_a_robot_that_does_not_answer_has_no_relative_degree() -> None:
    with pytest.raises(RobotError, match="did not answer"):
        relative_degree(LaggedRobot((10_000, 1), noise_std_m=0.001), 0)
