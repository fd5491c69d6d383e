"""References keep to the limits, for any robot and any request.

Real motions on recording robots: what is looked at is what a driver sees, from the rest before the
first sample to the rest after the last.
"""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from recording_robot import (
    MOTIONS,
    PROPERTY,
    SPEC,
    RecordingRobot,
    baselines,
    layout_of,
    performed,
    specs,
)

from nufleet.robot_agent.flight.flights import performance_of
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.motion.excitation import peak_velocity_and_acceleration
from nufleet.robot_agent.motion.monitor import rest_error_max
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import perform
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.paths.trajectories import speeds_and_accelerations, travel
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.motions import RichFlight, StepTest, Tracking
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

ROUNDING = 1 + 1e-6


def path_of(spec: RobotSpec, rng: np.random.Generator) -> FloatArray:
    """A path that begins anywhere in the workspace; refused paths are tested elsewhere."""
    limits = spec.tracking
    assert limits is not None
    points = 0.8 * limits.position_max * rng.uniform(-1, 1, (4, len(spec.axes)))
    try:
        path = travel(
            points, 0.9 * limits.speed_max, 0.6 * limits.acceleration_max, spec.sample_time_s
        )
    except InvalidInputError:
        path = np.empty((0, len(spec.axes)))
    assume(0 < len(path) < 20_000)
    return path


def assert_axis_limits(spec: RobotSpec, column: int, references: FloatArray) -> None:
    axis = spec.axes[column]
    assert not np.delete(references, column, axis=1).any()
    velocity, acceleration = peak_velocity_and_acceleration(
        references[:, column], spec.sample_time_s
    )
    assert np.abs(references[:, column]).max() <= ROUNDING * axis.amplitude_max
    assert velocity <= ROUNDING * axis.velocity_max
    assert acceleration <= ROUNDING * axis.acceleration_max


# References.


@PROPERTY
@given(specs(), st.data())
def test_a_frequency_test_keeps_to_the_limits_of_its_axis(
    spec: RobotSpec, data: st.DataObject
) -> None:
    column = data.draw(st.integers(0, len(spec.axes) - 1))
    tones = data.draw(
        st.lists(
            st.floats(spec.omega_min_rad_s, spec.omega_max_rad_s),
            min_size=1,
            max_size=3,
            unique=True,
        )
    )
    assume(len(tones) == 1 or np.diff(np.sort(tones)).min() > 0.1 * spec.omega_min_rad_s)
    robot = RecordingRobot(spec)
    motion = Excitation(
        axis=spec.axes[column].name, tones=tuple(Tone(omega_rad_s=omega) for omega in tones)
    )
    played = performed(robot, motion)
    assert played.outcome is Outcome.COMPLETED, played.reason
    assert_axis_limits(spec, column, robot.seen)


@PROPERTY
@given(specs(), st.data())
def test_a_step_test_keeps_to_the_limits_of_its_axis_and_needs_a_robot_that_tracks(
    spec: RobotSpec, data: st.DataObject
) -> None:
    column = data.draw(st.integers(0, len(spec.axes) - 1))
    robot, motion = RecordingRobot(spec), StepTest(axis=spec.axes[column].name)
    if spec.tracking is None:
        with pytest.raises(RefusedError, match="no tracking limits"):
            performed(robot, motion)
        assert not robot.references
        return
    played = performed(robot, motion)
    assert played.outcome is Outcome.COMPLETED, played.reason
    assert_axis_limits(spec, column, robot.seen)


@pytest.mark.thorough
@PROPERTY
@given(specs(tracks=True), st.integers(0, 1000))
def test_a_rich_flight_keeps_to_the_tracking_limits(spec: RobotSpec, seed: int) -> None:
    robot = RecordingRobot(spec)
    played = performed(robot, RichFlight(duration_s=1.0, seed=seed))
    assert played.outcome is Outcome.COMPLETED, played.reason
    assert spec.tracking is not None
    speeds, accelerations = speeds_and_accelerations(
        np.concatenate([np.zeros((1, len(spec.axes))), robot.seen]), spec.sample_time_s
    )
    assert np.abs(robot.seen).max() <= ROUNDING * spec.tracking.position_max
    assert speeds.max() <= ROUNDING * spec.tracking.speed_max
    assert accelerations.max() <= ROUNDING * spec.tracking.acceleration_max


@pytest.mark.thorough
@PROPERTY
@given(
    specs(tracks=True),
    st.sampled_from(["baseline", "zero-prior, guarded", "zero-prior"]),
    st.floats(0.0, 0.01),
    st.integers(0, 1000),
)
def test_a_path_is_reached_and_flown_within_the_limits_and_the_bounds_of_the_correction(
    spec: RobotSpec, inverse: str, noise: float, seed: int
) -> None:
    limits = spec.tracking
    assert limits is not None
    path = path_of(spec, np.random.default_rng(seed))
    if inverse != "baseline":
        path = path[: min(len(path), 300)]
        # Cut off in full motion it would be refused.
        path = np.concatenate([path, path[::-1]]) if len(path) == 300 else path
    robot = RecordingRobot(spec, noise=noise * limits.correction_max, seed=seed)
    motion = Tracking(
        desired=path,
        inverse="baseline" if inverse == "baseline" else "zero-prior",
        layout=None if inverse == "baseline" else layout_of(spec),
        guarded=inverse != "zero-prior",
    )
    try:
        played = performed(robot, motion, baselines(spec))
    except RefusedError as error:
        assume(error.code != "trajectory")
        raise
    assert played.outcome is Outcome.COMPLETED, played.reason
    flown = len(played.samples.reference)
    way, correction = robot.seen[:-flown], robot.seen[-flown:] - path
    assert np.abs(correction).max() <= ROUNDING * limits.correction_max
    steps = np.diff(correction, axis=0, prepend=np.zeros((1, len(spec.axes))))
    most = limits.correction_speed_max * spec.sample_time_s
    assert np.abs(steps).max() <= ROUNDING * most + 1e-12
    # The way to the start, and the path itself, as the robot sees them one after the other.
    whole = np.concatenate([np.zeros((1, len(spec.axes))), way, path])
    speeds, accelerations = speeds_and_accelerations(whole, spec.sample_time_s)
    assert np.abs(whole).max() <= ROUNDING * limits.position_max
    assert speeds.max() <= 1.02 * ROUNDING * limits.speed_max
    assert accelerations.max() <= 1.02 * ROUNDING * limits.acceleration_max


# Where a motion begins.


@pytest.mark.parametrize("kind", MOTIONS)
@pytest.mark.parametrize("share", [-1.01, 1.01, 40.0, np.nan])
def test_a_robot_that_rests_too_far_from_its_first_reference_is_not_begun(
    kind: str, share: float
) -> None:
    most = rest_error_max(SPEC, SPEC.axes[0])
    robot = RecordingRobot(SPEC, rests_at=share * most)
    played = performed(robot, MOTIONS[kind](SPEC), baselines(SPEC))
    assert played.outcome is Outcome.FAILED
    assert not robot.references
    assert played.fault is None
    assert len(played.samples.reference) == len(played.samples.response) == 0
    if np.isfinite(share):
        assert "axis x rests at" in played.reason
        assert f"at most {most:.3g} m from its first reference" in played.reason
        assert "has to rest at reference 0" in played.reason


@PROPERTY
@given(specs(), st.floats(-0.99, 0.99))
def test_a_robot_that_rests_within_what_its_limits_allow_is_begun(
    spec: RobotSpec, share: float
) -> None:
    robot = RecordingRobot(spec, rests_at=share * min(rest_error_max(spec, a) for a in spec.axes))
    omega = 0.5 * (spec.omega_min_rad_s + spec.omega_max_rad_s)
    motion = Excitation(axis=spec.axes[0].name, tones=(Tone(omega_rad_s=omega),))
    assert performed(robot, motion).outcome is Outcome.COMPLETED


def test_noise_larger_than_a_sample_of_motion_is_no_reason_not_to_begin() -> None:
    """At 1 kHz a robot of 1 m/s goes 1 mm in one sample; its sensor's noise is five times that."""
    spec = SPEC.model_copy(update={"sample_time_s": 0.001, "omega_max_rad_s": 100.0})
    for seed in range(4):
        robot = RecordingRobot(spec, noise=0.005, seed=seed)
        played = performed(robot, MOTIONS["excitation"](spec))
        assert played.outcome is Outcome.COMPLETED, played.reason


def test_a_robot_that_is_stopped_in_the_middle_of_a_path_begins_again() -> None:
    chosen = DoubleIntegratorSettings(alpha=0.85, beta=0.003, noise_std_m=0.002)
    robot = DoubleIntegrator(chosen, np.random.default_rng(0))
    robot.connect()
    path = travel(np.array([[0.0], [1.2], [0.0]]), 0.8, 1.5, robot.spec.sample_time_s)
    switch = HaltSwitch()

    def watch(sample: int, *_: object) -> None:
        if sample == len(path) // 2:
            switch.halt(Outcome.ABORTED, "stopped")

    stopped = performance_of(
        Tracking(desired=path, inverse="baseline"),
        robot,
        Memory(None),
        realtime=None,
        switch=switch,
        on_played=lambda samples: None,
        watch=watch,
    )
    played = perform(robot, stopped, switch, on_resting=lambda: None)
    assert played.outcome is Outcome.ABORTED
    assert played.samples.response[-1, 0] > 0.8
    again = performed(robot, Excitation(axis="x", tones=(Tone(omega_rad_s=1.5),)))
    assert again.outcome is Outcome.COMPLETED, again.reason
