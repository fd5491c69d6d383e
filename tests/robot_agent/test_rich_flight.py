"""Rich references keep to the limits and show the dynamics; steps show the relative degree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots_that_learn import LIMITS, LaggedRobot

from robot_agent.baseline_model import samples_needed
from robot_agent.rich_flight import STEPS_UP, fly_record, rich_references, step_references
from shared.errors import RobotError
from shared.trajectories import speeds_and_accelerations


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_references_keep_to_every_limit_and_reach_one(seed: int) -> None:
    spec = LaggedRobot().spec
    references = rich_references(spec, 60.0, np.random.default_rng(seed))
    assert len(references) * spec.sample_time_s >= 60.0
    velocities = np.diff(references, axis=0) / spec.sample_time_s
    accelerations = np.diff(velocities, axis=0) / spec.sample_time_s
    position = np.abs(references) / LIMITS.position_max
    speed = np.linalg.norm(velocities, axis=1) / LIMITS.speed_max
    pull = np.linalg.norm(accelerations, axis=1) / LIMITS.acceleration_max
    largest = [float(share.max()) for share in (position, speed, pull)]
    assert max(largest) <= 1.02
    assert max(largest) >= 0.99
    np.testing.assert_allclose(references[[0, -1]], 0.0, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from([(0.01, 0.3), (0.001, 0.02), (0.1, 1.0), (0.5, 5.0), (10.0, 30.0)]),
    st.sampled_from([0.02, 0.1, 1.0]),
    st.sampled_from([0.0, 0.3, 5.0]),
    st.integers(0, 1000),
)
def test_references_stay_in_the_band_of_a_robot_of_any_speed(
    band_rad_s: tuple[float, float], sample_time_s: float, settling_time_s: float, seed: int
) -> None:
    lowest, highest = band_rad_s
    assume(highest < np.pi / sample_time_s)
    spec = LaggedRobot().spec.model_copy(
        update={
            "omega_min_rad_s": lowest,
            "omega_max_rad_s": highest,
            "sample_time_s": sample_time_s,
            "settling_time_s": settling_time_s,
        }
    )
    references = rich_references(spec, 60.0, np.random.default_rng(seed))
    speeds, accelerations = speeds_and_accelerations(references, sample_time_s)
    assert np.abs(references).max() <= (1 + 1e-9) * LIMITS.position_max
    assert speeds.max() <= (1 + 1e-9) * LIMITS.speed_max
    assert accelerations.max() <= (1 + 1e-9) * LIMITS.acceleration_max
    power = (np.abs(np.fft.rfft(references, axis=0)) ** 2).sum(axis=1)
    omega_rad_s = 2 * np.pi * np.fft.rfftfreq(len(references), sample_time_s)
    assert power[omega_rad_s > highest].sum() < 0.05 * power.sum()
    # The baseline is always learned from it.
    assert len(references) >= samples_needed(sample_time_s, settling_time_s)


def test_the_same_generator_gives_the_same_references() -> None:
    spec = LaggedRobot().spec
    first, again = (rich_references(spec, 60.0, np.random.default_rng(3)) for _ in range(2))
    np.testing.assert_array_equal(first, again)


def test_a_record_holds_the_state_before_each_reference_acted() -> None:
    robot = LaggedRobot((3, 5))
    references = np.random.default_rng(0).standard_normal((40, 2))
    record = fly_record(robot, references)
    np.testing.assert_array_equal(record.states[3:, 0, 0], references[:-3, 0])
    np.testing.assert_array_equal(record.states[5:, 1, 0], references[:-5, 1])
    assert robot.rests == 1


def test_a_sensor_that_measures_nan_gives_no_record() -> None:
    with pytest.raises(RobotError, match="not finite at sample 7"):
        fly_record(LaggedRobot(blind_at=7), np.zeros((20, 2)))


def test_steps_go_up_and_down_on_one_axis_from_rest_to_rest() -> None:
    spec = LaggedRobot().spec
    references = step_references(spec, 1)
    height = spec.axes[1].velocity_max * spec.sample_time_s
    assert set(np.unique(references[:, 1])) == {0.0, height}
    assert not references[:, 0].any()
    assert (
        (np.diff(references[:, 1]) > 0).sum() == (np.diff(references[:, 1]) < 0).sum() == STEPS_UP
    )
    assert references[0, 1] == references[-1, 1] == 0.0
