"""Rich references keep to the limits and show the dynamics; steps show the relative degree."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from robots_that_learn import LIMITS, LaggedRobot

from nufleet.robot_agent.flight.rich_flight import fly_record
from nufleet.robot_agent.motion.excitation import peak_velocity_and_acceleration
from nufleet.shared.errors import RobotError
from nufleet.shared.paths.references import STEPS_UP_MIN, rich_references, step_references
from nufleet.shared.paths.trajectories import speeds_and_accelerations


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
    st.sampled_from([5.0, 60.0]),
    st.integers(0, 1000),
)
def test_references_stay_in_the_band_of_a_robot_of_any_speed(
    band_rad_s: tuple[float, float],
    sample_time_s: float,
    settling_time_s: float,
    duration_s: float,
    seed: int,
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
    references = rich_references(spec, duration_s, np.random.default_rng(seed))
    speeds, accelerations = speeds_and_accelerations(references, sample_time_s)
    assert np.abs(references).max() <= (1 + 1e-9) * LIMITS.position_max
    assert speeds.max() <= (1 + 1e-9) * LIMITS.speed_max
    assert accelerations.max() <= (1 + 1e-9) * LIMITS.acceleration_max
    power = (np.abs(np.fft.rfft(references, axis=0)) ** 2).sum(axis=1)
    omega_rad_s = 2 * np.pi * np.fft.rfftfreq(len(references), sample_time_s)
    # A tone at the upper edge shows in the line next to it, up to half a spacing above.
    assert power[omega_rad_s > highest + omega_rad_s[1] / 2].sum() < 0.05 * power.sum()


@pytest.mark.parametrize("duration_s", [5.0, 10.0, 15.0, 60.0])
def test_a_flight_lasts_as_long_as_it_is_asked_to(duration_s: float) -> None:
    spec = LaggedRobot().spec
    references = rich_references(spec, duration_s, np.random.default_rng(0))
    assert len(references) * spec.sample_time_s == pytest.approx(duration_s, abs=0.1)
    assert np.abs(references).max() > 0.1


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


@settings(max_examples=100, deadline=None)
@given(
    sample_time_s=st.sampled_from([0.001, 0.015, 0.02, 0.1, 1.0]),
    settling_time_s=st.sampled_from([0.0, 0.3, 4.0, 30.0]),
    amplitude_max=st.floats(1e-3, 10.0),
    velocity_max=st.floats(1e-3, 10.0),
    acceleration_max=st.floats(1e-3, 100.0),
)
def test_steps_keep_to_the_limits_of_their_axis_from_rest_to_rest(
    sample_time_s: float,
    settling_time_s: float,
    amplitude_max: float,
    velocity_max: float,
    acceleration_max: float,
) -> None:
    spec = LaggedRobot().spec
    limits = {
        "amplitude_max": amplitude_max,
        "velocity_max": velocity_max,
        "acceleration_max": acceleration_max,
    }
    axes = (spec.axes[0], spec.axes[1].model_copy(update=limits))
    timing = {"sample_time_s": sample_time_s, "settling_time_s": settling_time_s}
    references = step_references(spec.model_copy(update={"axes": axes, **timing}), 1)
    assert not references[:, 0].any()
    assert not references[[0, -1]].any()
    shares = np.array(
        [
            np.abs(references[:, 1]).max() / amplitude_max,
            *np.array(peak_velocity_and_acceleration(references[:, 1], sample_time_s))
            / [velocity_max, acceleration_max],
        ]
    )
    assert shares.max() <= 1.0
    moves = np.diff(references[:, 1], prepend=0.0)
    begins = np.flatnonzero((moves[1:] != 0) & (moves[:-1] == 0)) + 1
    assert len(begins) >= 2 * STEPS_UP_MIN
    signs = np.sign(moves[begins])
    assert signs.sum() == 0
    # As many follow one the same way as one the other way.
    assert abs((signs[1:] * signs[:-1]).sum()) <= 1


def test_steps_are_as_quick_as_the_limits_allow() -> None:
    spec = LaggedRobot().spec.model_copy(update={"sample_time_s": 0.002})
    references = step_references(spec, 0)[:, 0]
    _, acceleration = peak_velocity_and_acceleration(references, spec.sample_time_s)
    assert acceleration == pytest.approx(0.8 * spec.axes[0].acceleration_max)
    # Where acceleration is no limit, speed is.
    axis = spec.axes[0].model_copy(update={"acceleration_max": 1e6})
    quick = step_references(spec.model_copy(update={"axes": (axis,)}), 0)[:, 0]
    velocity, _ = peak_velocity_and_acceleration(quick, spec.sample_time_s)
    assert velocity == pytest.approx(0.8 * axis.velocity_max)
