"""A sensor that fails ends a motion of any kind soon, with a reason; a noisy one ends none."""

from __future__ import annotations

import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_robot import (
    MOTIONS,
    SPEC,
    RecordingRobot,
    Sensor,
    baselines,
    performed,
)

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.motion.pace import CHUNK_SAMPLES
from nufleet.shared.arrays import FloatArray
from nufleet.shared.wire.messages import Outcome


def not_a_number(onset: int) -> Sensor:
    return lambda k, output: np.full_like(output, np.nan) if k >= onset else output


def frozen(onset: int) -> Sensor:
    held: list[FloatArray] = []

    def sensor(k: int, output: FloatArray) -> FloatArray:
        if k < onset:
            return output
        held.append(output)
        return held[0]

    return sensor


def late(samples: int) -> Sensor:
    """Before it has anything to say it measures rest, with a noise of its own."""
    rng = np.random.default_rng(0)
    past: list[FloatArray] = []

    def sensor(k: int, output: FloatArray) -> FloatArray:
        past.append(output)
        if len(past) > samples:
            return past[-1 - samples]
        return 1e-4 * rng.standard_normal(len(output))

    return sensor


def displaced(onset: int) -> Sensor:
    return lambda k, output: output + 0.9 if k >= onset else output


FAULTS = {
    "NaN": (not_a_number, "not finite"),
    "frozen": (frozen, "stays at exactly"),
    "displaced": (displaced, "jumps|does not follow"),
}


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.parametrize("kind", MOTIONS)
@settings(max_examples=3, deadline=None)
@given(onset=st.integers(1, 400), noise=st.sampled_from([0.0, 0.002]))
def test_a_sensor_that_fails_ends_every_motion_soon_and_teaches_nothing(
    kind: str, fault: str, simulated: bool, onset: int, noise: float
) -> None:
    spec = SPEC.model_copy(update={"simulated": simulated})
    robot, memory = RecordingRobot(spec, noise=noise), baselines(spec)
    known = dict(memory.flown_s)
    sensor, words = FAULTS[fault]
    robot.sensor = sensor(onset)
    played = performed(robot, MOTIONS[kind](spec), memory)
    assert played.outcome is Outcome.FAILED
    assert re.search(words, played.reason)
    assert played.fault is None
    assert robot.rests > 0
    assert dict(memory.flown_s) == known
    # Until the reference has moved by a tenth of its range and the robot should have settled.
    late = {"NaN": 1, "frozen": 400, "displaced": 5}[fault]
    batch = CHUNK_SAMPLES if simulated else 1
    assert len(robot.references) <= onset + late + batch


@pytest.mark.parametrize("realtime", [None, 1e9])
@pytest.mark.parametrize("kind", MOTIONS)
def test_a_sensor_that_lags_by_much_more_than_the_robot_settles_in_ends_every_motion(
    kind: str, realtime: float | None
) -> None:
    robot, memory = RecordingRobot(SPEC, noise=0.001), baselines(SPEC)
    known = dict(memory.flown_s)
    robot.sensor = late(400)
    played = performed(robot, MOTIONS[kind](SPEC), memory, realtime=realtime)
    assert played.outcome is Outcome.FAILED
    assert re.search("does not follow|begins to move .* after its reference", played.reason)
    assert len(played.samples.reference) < 500
    assert played.fault is None
    assert dict(memory.flown_s) == known


def test_what_a_sensor_lagged_by_in_a_rich_flight_is_no_baseline() -> None:
    """Three settling times late: each output is where the robot was, and none is far off."""
    robot, memory = RecordingRobot(SPEC), Memory(None)
    robot.sensor = late(75)
    played = performed(robot, MOTIONS["rich flight"](SPEC), memory)
    assert played.outcome is Outcome.FAILED
    assert "does not explain" in played.reason
    assert not memory.flown_s


@pytest.mark.parametrize("kind", MOTIONS)
@settings(max_examples=4, deadline=None)
@given(
    noise=st.floats(0.0, 0.03),
    spikes=st.sampled_from([0.0, 0.03]),
    lost=st.sampled_from([0.0, 0.05]),
    seed=st.integers(0, 1000),
)
def test_noise_single_spikes_and_lost_samples_end_no_motion(
    kind: str, noise: float, spikes: float, lost: float, seed: int
) -> None:
    robot = RecordingRobot(SPEC, noise=noise, seed=seed)
    rng = np.random.default_rng(seed)
    last = np.zeros(2)
    after = 0

    def sensor(k: int, output: FloatArray) -> FloatArray:
        """Fail in single samples, of which the monitor accepts every sixth."""
        nonlocal last, after
        spike, loss = rng.random(2) < (spikes, lost)
        read = output.copy()
        if k >= after and (spike or loss):
            after = k + 6
            read = output + 5.0 * (rng.random(2) < 0.5) if spike else last
        last = read
        return read

    robot.sensor = sensor
    played = performed(robot, MOTIONS[kind](SPEC), baselines(SPEC))
    # A baseline is not learned from spikes of 5 m; the flight itself goes to its end.
    assert played.outcome is Outcome.COMPLETED or "does not explain" in played.reason
    assert played.fault is None
