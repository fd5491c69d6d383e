"""A driver that does not return is noticed, by the time that its process was running."""

from __future__ import annotations

import threading
from types import SimpleNamespace

import numpy as np
import pytest
from polling import PATIENCE_S
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.motion import watched_robot
from nufleet.robot_agent.motion.pace import GAP_MAX_S
from nufleet.robot_agent.motion.watched_robot import SLOW_CALL_MAX_S, WatchedRobot
from nufleet.shared.errors import RobotError


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0

    def pass_s(self, seconds: float) -> None:
        self.now_s += seconds


class Stuck:
    """A puppet that stays inside one call until it is released."""

    def __init__(self, call: str, realtime: float | None) -> None:
        self.inside, self.let_go = threading.Event(), threading.Event()
        puppet = PuppetRobot()
        self.robot = WatchedRobot(puppet, realtime=realtime)
        if call != "connect":
            self.robot.connect()
        hook = {"step": "on_sample", "rest": "on_rest", "connect": "on_connect"}[call]
        setattr(puppet, hook, lambda *_: self.wait())
        calls = {
            "step": lambda: self.robot.step(np.zeros(2)),
            "rest": self.robot.rest,
            "connect": self.robot.connect,
        }
        self._thread = threading.Thread(target=calls[call])

    def wait(self) -> None:
        self.inside.set()
        assert self.let_go.wait(PATIENCE_S)

    def __enter__(self) -> WatchedRobot:
        self._thread.start()
        assert self.inside.wait(PATIENCE_S)
        self.robot.look()
        return self.robot

    def __exit__(self, *_: object) -> None:
        self.let_go.set()
        self._thread.join()


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    clock = Clock()
    monkeypatch.setattr(watched_robot, "time", SimpleNamespace(monotonic=lambda: clock.now_s))
    return clock


@pytest.mark.parametrize(
    ("call", "realtime", "allowed_s"),
    [
        ("step", 1.0, GAP_MAX_S + 0.01),
        ("step", None, SLOW_CALL_MAX_S),
        ("rest", 1.0, SLOW_CALL_MAX_S),
        ("connect", 1.0, SLOW_CALL_MAX_S),
    ],
)
def test_a_call_that_lasts_too_long_is_named(
    call: str, realtime: float | None, allowed_s: float, clock: Clock
) -> None:
    with Stuck(call, realtime) as robot:
        looks = 0.0
        while looks + 0.5 < allowed_s:
            clock.pass_s(0.5)
            looks += 0.5
            assert robot.look() is None
            assert not robot.hangs
        clock.pass_s(0.6)
        found = robot.look()
        assert found is not None
        assert f"has not returned from '{call}'" in found
        assert robot.hangs
    assert robot.look() is None
    assert not robot.hangs


def test_a_process_that_was_frozen_does_not_blame_its_driver(clock: Clock) -> None:
    with Stuck("step", 1.0) as robot:
        clock.pass_s(3600.0)
        assert robot.look() is None


def test_time_between_calls_does_not_count(clock: Clock) -> None:
    robot = WatchedRobot(PuppetRobot(), realtime=1.0)
    robot.connect()
    for _ in range(100):
        clock.pass_s(1.0)
        assert robot.look() is None
        robot.step(np.zeros(2))


@pytest.mark.parametrize(("simulated", "late"), [(False, 2), (True, 0)])
def test_samples_of_a_real_robot_that_begin_late_are_counted(
    simulated: bool, late: int, clock: Clock
) -> None:
    robot = WatchedRobot(PuppetRobot(puppet_spec(simulated=simulated)), realtime=None)
    robot.connect()
    for _ in range(2):
        for pause_s in (0.01, 0.019, 0.01, 0.021, 0.0):  # of 0.01 s each
            robot.step(np.zeros(2))
            clock.pass_s(pause_s)
        clock.pass_s(30.0)
        robot.rest()
        clock.pass_s(30.0)
    assert robot.late_samples == late


def test_no_second_thread_reaches_a_driver_that_is_busy(clock: Clock) -> None:
    with Stuck("step", 1.0) as robot:
        for call in (robot.rest, robot.disconnect, robot.connect, robot.observe):
            with pytest.raises(RobotError, match="has not returned from 'step'"):
                call()
    robot.rest()
    robot.disconnect()


def test_what_a_driver_raises_is_passed_on_and_it_may_be_called_again(clock: Clock) -> None:
    puppet = PuppetRobot()
    robot = WatchedRobot(puppet, realtime=None)

    def on_connect() -> None:
        raise RobotError("no such port")

    puppet.on_connect = on_connect
    with pytest.raises(RobotError, match="no such port"):
        robot.connect()
    puppet.on_connect = lambda: None
    robot.connect()
    assert robot.spec == puppet.spec
    assert robot.state_names == puppet.state_names
    assert np.array_equal(robot.run(np.ones((3, 2))), np.ones((3, 2)))
    assert robot.observe().shape == (2, 0)
