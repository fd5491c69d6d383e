"""Performing a motion from rest to rest, no matter what the robot does meanwhile."""

from __future__ import annotations

import re
import threading
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from polling import PATIENCE_S
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.motion import pace
from nufleet.robot_agent.motion.pace import CHUNK_SAMPLES, HaltSwitch
from nufleet.robot_agent.motion.perform import AxisMotion, Played, perform
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.wire.messages import Outcome
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

SINE = np.sin(np.linspace(0.0, 20.0, 1000))


def connected(robot: PuppetRobot) -> PuppetRobot:
    robot.connect()
    return robot


def played(
    robot: PuppetRobot,
    reference: FloatArray = SINE,
    *,
    axis: str = "x",
    realtime: float | None = None,
    switch: HaltSwitch | None = None,
    watched: bool = True,
) -> Played:
    """Play and check what holds for every motion; return it."""
    batches: list[tuple[int, FloatArray, FloatArray]] = []
    order: list[str] = []

    def on_samples(first: int, references: FloatArray, responses: FloatArray) -> None:
        order.append("samples")
        batches.append((first, references.copy(), responses.copy()))

    switch = HaltSwitch() if switch is None else switch
    motion = AxisMotion(
        robot,
        [axis],
        reference,
        realtime=realtime,
        switch=switch,
        on_samples=on_samples,
        watched=lambda: watched,
    )
    result = perform(robot, motion, switch, on_resting=lambda: order.append("resting"))
    done = len(result.samples.reference)
    np.testing.assert_array_equal(result.samples.reference, reference[:done])
    assert np.isfinite(result.samples.response).all()
    assert len(result.samples.response) == done
    assert order[-1] == "resting"
    assert "resting" not in order[:-1]
    follows = 0
    for first, references, responses in batches:
        assert first == follows
        np.testing.assert_array_equal(
            references, result.samples.reference[first : first + len(references)]
        )
        np.testing.assert_array_equal(
            responses, result.samples.response[first : first + len(responses)]
        )
        follows += len(references)
    assert follows == done
    if result.outcome is Outcome.COMPLETED:
        assert done == len(reference)
    else:
        assert result.reason
    assert robot.at_rest or result.fault is not None
    return result


# What goes well.


@settings(max_examples=30, deadline=None)
@given(samples=st.integers(1, 1200), axis=st.sampled_from("xy"), paced=st.booleans())
def test_a_motion_plays_its_reference_on_its_axis_alone(
    samples: int, axis: str, paced: bool
) -> None:
    robot = connected(PuppetRobot())
    reference = np.linspace(0.1, 1.0, samples)
    result = played(robot, reference, axis=axis, realtime=1e9 if paced else None)
    assert result.outcome is Outcome.COMPLETED
    assert result.reason == ""
    assert result.fault is None
    np.testing.assert_array_equal(result.samples.response, reference)
    sent = np.concatenate(robot.references)
    column = "xy".index(axis)
    np.testing.assert_array_equal(sent[:, column], reference)
    np.testing.assert_array_equal(sent[:, 1 - column], 0.0)
    assert robot.motions == 1


def test_a_double_integrator_gives_the_same_response_in_any_batches() -> None:
    settings = DoubleIntegratorSettings(alpha=0.85, beta=0.003, noise_std_m=0.01)

    def response(realtime: float | None) -> FloatArray:
        robot = DoubleIntegrator(settings, np.random.default_rng(5))
        robot.connect()
        motion = AxisMotion(
            robot,
            ["x"],
            SINE,
            realtime=realtime,
            switch=HaltSwitch(),
            on_samples=lambda *_: None,
        )
        assert motion.play() == (Outcome.COMPLETED, "")
        return motion.measured().response

    np.testing.assert_array_equal(response(None), response(1e9))


def test_a_simulation_plays_large_batches_and_a_real_robot_single_samples() -> None:
    fast, real = connected(PuppetRobot()), connected(PuppetRobot(puppet_spec(simulated=False)))
    played(fast)
    played(real)
    assert max(fast.batches) == CHUNK_SAMPLES
    assert set(real.batches) == {1}


def test_a_simulation_is_not_called_more_often_because_its_states_are_observed() -> None:
    calls: list[int] = []

    class Counted(DoubleIntegrator):
        def run_observed(
            self, references: FloatArray, observed: Sequence[int]
        ) -> tuple[FloatArray, FloatArray]:
            calls.append(len(references))
            return super().run_observed(references, observed)

    robot = Counted(DoubleIntegratorSettings(alpha=0.85, beta=0.003), np.random.default_rng(5))
    robot.connect()
    motion = AxisMotion(
        robot, ["x"], SINE, realtime=None, switch=HaltSwitch(), on_samples=lambda *_: None
    )
    assert motion.play() == (Outcome.COMPLETED, "")
    assert calls == [CHUNK_SAMPLES] * 3 + [len(SINE) - 3 * CHUNK_SAMPLES]
    states = motion.measured().states
    assert states is not None
    seen = np.isfinite(states).all(axis=(1, 2))
    np.testing.assert_array_equal(seen, np.arange(len(SINE)) % 64 < 3)
    np.testing.assert_array_equal(states[seen, 0, 0], motion.measured().response[seen])


class Clock(HaltSwitch):
    """A switch for which time passes only while a motion waits on it, or as a test says."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s, self.waited_s = 100.0, 0.0

    def wait(self, timeout_s: float) -> None:
        self.now_s += timeout_s
        self.waited_s += timeout_s


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(pace, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    return clock


def test_a_paced_simulation_takes_its_time(clock: Clock) -> None:
    robot = connected(PuppetRobot(puppet_spec(sample_time_s=0.02)))
    played(robot, SINE[:30], realtime=4.0, switch=clock)
    assert clock.waited_s == pytest.approx(29 * 0.02 / 4.0)


def test_a_real_robot_is_left_to_its_own_pace(clock: Clock) -> None:
    robot = connected(PuppetRobot(puppet_spec(simulated=False, sample_time_s=0.05)))
    played(robot, SINE[:30], realtime=0.01, switch=clock)
    assert clock.waited_s == 0.0


def test_a_paced_simulation_that_was_late_goes_on_at_its_pace(clock: Clock) -> None:
    times_s: list[float] = []
    last = round(pace.BATCH_S / 0.02)  # sample of the batch after the first sample

    def on_sample(k: int) -> None:
        times_s.append(clock.now_s)
        if k == last:
            clock.now_s += pace.CATCH_UP_MAX_S + 0.2

    robot = connected(PuppetRobot(puppet_spec(sample_time_s=0.02)))
    robot.on_sample = on_sample
    assert played(robot, SINE[:200], realtime=1.0, switch=clock).outcome is Outcome.COMPLETED
    # It makes up for CATCH_UP_MAX_S of its lateness and no more.
    took_s = (199 - (last + 1)) * 0.02 - pace.CATCH_UP_MAX_S
    assert times_s[199] - times_s[last + 1] == pytest.approx(took_s)


@pytest.mark.parametrize("sample_time_s", [0.001, 0.015, 0.03, 0.06])
@pytest.mark.parametrize("realtime", [1.0, 4.0])
@pytest.mark.parametrize("watched", [True, False])
def test_a_paced_simulation_plays_no_sample_before_its_time_and_none_long_after_it(
    sample_time_s: float, realtime: float, watched: bool, clock: Clock
) -> None:
    batch_s = pace.BATCH_S if watched else pace.UNWATCHED_BATCH_S
    times_s: list[float] = []
    robot = connected(PuppetRobot(puppet_spec(sample_time_s=sample_time_s)))
    robot.on_sample = lambda k: times_s.append(clock.now_s)
    played(robot, SINE[:200], realtime=realtime, switch=clock, watched=watched)
    late_s = np.array(times_s) - times_s[0] - np.arange(200) * sample_time_s / realtime
    assert late_s.min() > -1e-9
    assert late_s.max() < batch_s + 1e-9
    # No more often than it must, save for the first sample.
    wakes = np.unique(times_s)
    assert len(wakes) <= 2 + 200 / max(1, round(batch_s * realtime / sample_time_s))


# What ends it early.


@pytest.mark.parametrize("simulated", [True, False])
@pytest.mark.parametrize("outcome", [Outcome.CANCELLED, Outcome.ABORTED])
def test_a_thrown_switch_ends_the_motion_at_rest(outcome: Outcome, simulated: bool) -> None:
    robot, switch = connected(PuppetRobot(puppet_spec(simulated=simulated))), HaltSwitch()

    def on_sample(k: int) -> None:
        if k == 300:
            switch.halt(outcome, "enough")
            switch.halt(Outcome.FAILED, "too late to say otherwise")

    robot.on_sample = on_sample
    result = played(robot, switch=switch)
    assert (result.outcome, result.reason, result.fault) == (outcome, "enough", None)
    assert len(result.samples.reference) == (2 * CHUNK_SAMPLES if simulated else 301)


def test_a_switch_thrown_before_the_first_sample_moves_nothing() -> None:
    robot, switch = connected(PuppetRobot()), HaltSwitch()
    switch.halt(Outcome.CANCELLED, "never mind")
    result = played(robot, switch=switch)
    assert (result.outcome, len(result.samples.reference)) == (Outcome.CANCELLED, 0)
    assert robot.motions == 0


def test_a_slow_pace_does_not_delay_a_halt() -> None:
    robot, switch = connected(PuppetRobot(puppet_spec(sample_time_s=0.01))), HaltSwitch()
    threading.Timer(0.05, lambda: switch.halt(Outcome.ABORTED, "stopped")).start()
    result = played(robot, realtime=1e-4, switch=switch)  # one sample in 100 s
    assert result.outcome is Outcome.ABORTED
    assert len(result.samples.reference) <= 1


def test_of_many_halts_from_many_threads_one_is_kept() -> None:
    switch = HaltSwitch()
    begin = threading.Barrier(8)
    seen: list[tuple[Outcome, str] | None] = []

    def throw(k: int) -> None:
        begin.wait(PATIENCE_S)
        switch.halt(Outcome.ABORTED, str(k))
        seen.append(switch.order)

    threads = [threading.Thread(target=throw, args=(k,)) for k in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(PATIENCE_S)
    assert len(seen) == 8
    assert set(seen) == {switch.order}


def test_a_stop_does_not_wait_for_a_batch_that_nobody_watches(clock: Clock) -> None:
    robot = connected(PuppetRobot(puppet_spec(sample_time_s=0.01)))
    waits_s: list[float] = []

    def wait(timeout_s: float) -> None:
        waits_s.append(timeout_s)
        if len(waits_s) == 3:
            clock.now_s += 0.3
            clock.halt(Outcome.ABORTED, "stopped")
        else:
            clock.now_s += timeout_s

    clock.wait = wait  # type: ignore[method-assign]
    result = played(robot, realtime=1.0, switch=clock, watched=False)
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "stopped")
    assert waits_s[2] == pytest.approx(pace.UNWATCHED_BATCH_S)
    assert len(result.samples.reference) == 1 + round(pace.UNWATCHED_BATCH_S / 0.01)


@pytest.mark.parametrize("simulated", [True, False])
def test_a_process_that_was_frozen_ends_its_motion(simulated: bool, clock: Clock) -> None:
    robot = connected(PuppetRobot(puppet_spec(simulated=simulated, sample_time_s=0.001)))
    last = round(pace.BATCH_S / 0.001)  # sample of the batch after the first sample

    def on_sample(k: int) -> None:
        if k == last:
            clock.now_s += pace.GAP_MAX_S + 0.1

    robot.on_sample = on_sample
    result = played(robot, realtime=1.0, switch=clock)
    assert result.outcome is Outcome.ABORTED
    assert re.search(rf"nothing happened for \d\.\d s before sample {last + 1}", result.reason)
    assert len(result.samples.reference) == last + 1


# What the robot does wrong.


@pytest.mark.parametrize("number", [np.nan, np.inf, -np.inf])
@pytest.mark.parametrize("realtime", [None, 1e9])
@pytest.mark.parametrize("column", [0, 1])
@pytest.mark.parametrize("bad", [0, 300, 999])
def test_a_sensor_that_is_not_finite_fails_the_motion_with_the_samples_before(
    number: float, realtime: float | None, column: int, bad: int
) -> None:
    robot = connected(PuppetRobot())

    def measure(references: FloatArray) -> FloatArray:
        measured = references.copy()
        index = bad - (robot.samples - len(references))
        if 0 <= index < len(measured):
            measured[index, column] = number
        return measured

    robot.measure = measure
    result = played(robot, realtime=realtime)
    assert result.outcome is Outcome.FAILED
    assert result.reason == f"the sensor returned a value that is not finite at sample {bad}"
    assert len(result.samples.reference) == bad
    assert result.fault is None


def test_a_robot_error_fails_the_motion_and_leaves_the_robot_trusted() -> None:
    robot = connected(PuppetRobot())

    def on_sample(k: int) -> None:
        if k == 600:
            raise RobotError("the gripper is open")

    robot.on_sample = on_sample
    result = played(robot)
    assert (result.outcome, result.reason) == (Outcome.FAILED, "the gripper is open")
    assert len(result.samples.reference) == 512
    assert result.fault is None


@pytest.mark.parametrize("error", [OSError("serial line gone"), ValueError("?"), AssertionError()])
def test_any_other_error_of_the_driver_fails_the_motion_with_a_fault_at_rest(
    error: Exception,
) -> None:
    robot = connected(PuppetRobot())

    def on_sample(k: int) -> None:
        if k == 600:
            raise error

    robot.on_sample = on_sample
    result = played(robot)
    assert result.outcome is Outcome.FAILED
    assert repr(error) in result.reason
    assert result.fault == result.reason
    assert robot.at_rest


def test_a_driver_that_returns_the_wrong_shape_has_a_fault() -> None:
    robot = connected(PuppetRobot())
    robot.measure = lambda references: references[:, :0]
    result = played(robot)
    assert result.outcome is Outcome.FAILED
    assert result.fault is not None
    assert robot.at_rest


@pytest.mark.parametrize("error", [RobotError("the brake is stuck"), OSError("the brake is stuck")])
@pytest.mark.parametrize("halted", [True, False])
def test_a_robot_that_does_not_come_to_rest_has_a_fault_however_its_motion_went(
    error: Exception, halted: bool
) -> None:
    robot, switch = connected(PuppetRobot()), HaltSwitch()

    def on_rest() -> None:
        raise error

    robot.on_rest = on_rest
    if halted:
        switch.halt(Outcome.CANCELLED, "cancelled")
    result = played(robot, switch=switch)
    assert result.outcome is Outcome.FAILED
    assert "could not come to rest" in result.reason
    assert "the brake is stuck" in result.reason
    assert result.reason.startswith("cancelled; ") == halted
    assert result.fault == result.reason


@pytest.mark.parametrize("error", [OSError("no such log"), RobotError("no such log")])
def test_a_record_that_cannot_be_read_fails_the_motion_and_leaves_the_robot_at_rest(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    robot = connected(PuppetRobot())

    def fails() -> None:
        raise error

    monkeypatch.setattr(robot, "record", fails)
    result = played(robot)
    assert robot.at_rest
    assert result.outcome is Outcome.FAILED
    assert "no such log" in result.reason
    assert len(result.samples.reference) == len(SINE)
    assert (result.fault is None) == isinstance(error, RobotError)
