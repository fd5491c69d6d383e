"""Rounds that are interrupted, and robots that are not heard for a while."""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fleet_lab import submitted
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot
from round_lab import KEYS, ROBOTS, STUDY, TEST, Lab, agent_of, start_lab

from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.fleet.goal_runner import Interrupted
from nufleet.orchestrator.fleet.requests import Reply
from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.study.outcomes import Measured
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RefusedError, RobotError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest, GoalResult, Outcome, RobotState
from nufleet.shared.wire.transport import open_client

LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=0.5),))
SOME_SECONDS = Excitation(axis="x", tones=(Tone(omega_rad_s=6.0),))


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield start_lab(stack, tmp_path, realtime=1.0)


class Ear:
    """Keeps the states of a robot from its orchestrator for as long as one wants."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, robot: str) -> None:
        self.deaf = False
        self._missed: list[tuple[RobotWatch, RobotState]] = []
        self._hear = RobotWatch.set_state

        def hear(watch: RobotWatch, state: RobotState) -> None:
            if self.deaf and watch.robot == robot:
                self._missed.append((watch, state))
            else:
                self._hear(watch, state)

        monkeypatch.setattr(RobotWatch, "set_state", hear)

    def has_missed(self, goal_id: str | None) -> bool:
        return any(state.goal_id == goal_id for _, state in self._missed)

    def hear_late(self, goal_id: str | None) -> None:
        """Let arrive what it said of a goal, or of none, while it was not heard."""
        for watch, state in self._missed:
            if state.goal_id == goal_id:
                self._hear(watch, state)


def asked_about(lab: Lab, monkeypatch: pytest.MonkeyPatch) -> threading.Event:
    """Return what is set when a robot is asked how its goal ended."""
    asked, ask = threading.Event(), lab.fleet.result_later

    def result_later(robot: str, goal_id: str) -> Reply[GoalResult]:
        asked.set()
        return ask(robot, goal_id)

    monkeypatch.setattr(lab.fleet, "result_later", result_later)
    return asked


def all_moving(lab: Lab) -> dict[str, threading.Event]:
    """Return what is set for each robot when it moves."""
    moving = {name: threading.Event() for name in lab.robots}
    for name, robot in lab.robots.items():
        robot.on_sample = lambda k, name=name: moving[name].set()  # type: ignore[misc]
    return moving


# What was asked for before the end never happens after it.


def test_a_goal_that_its_agent_died_of_moves_nothing_after_an_interrupt(
    lab: Lab, tmp_path: Path
) -> None:
    robot, asked = PuppetRobot(), threading.Event()
    dispatcher = lab.dispatcher()
    (test,) = lab.open_tests(r9=TEST)
    with ThreadPoolExecutor(1) as pool:
        with open_client(lab.endpoint, timeout_s=PATIENCE_S) as dying:
            dying.serve(
                KEYS.command("r9", "orchestrator-test", "goal"), lambda request: asked.set()
            )
            dying.declare_alive(KEYS.robot("r9", "alive"))
            lab.fleet.wait_for(("r9",), timeout_s=PATIENCE_S)
            running = pool.submit(dispatcher.run, [test])
            assert asked.wait(PATIENCE_S)
        dispatcher.interrupt()
        with agent_of(lab.endpoint, "r9", robot, realtime=1.0, state_folder=tmp_path / "r9"):
            with pytest.raises(Interrupted):
                running.result(PATIENCE_S)
            assert lab.trials() == [(test.goal_id, TrialStatus.INTENDED)]
    # Nor does it when it arrives late, whichever agent process it finds.
    with agent_of(lab.endpoint, "r9", robot, realtime=1.0, state_folder=tmp_path / "r9"):
        lab.fleet.wait_for(("r9",), timeout_s=PATIENCE_S)
        owner = lab.fleet.orchestrator_id
        late = GoalRequest(goal_id=test.goal_id, owner=owner, epoch=lab.epoch, motion=TEST)
        with pytest.raises(RefusedError, match="cancelled before it arrived"):
            submitted(lab.fleet, "r9", late)
    assert robot.motions == 0


def test_all_robots_are_cancelled_at_once_though_one_does_not_answer(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    moving = all_moving(lab)
    resting = {name: threading.Event() for name in ROBOTS}
    for name, robot in lab.robots.items():
        robot.on_rest = resting[name].set
    all_asked, cancel = threading.Barrier(3), lab.fleet.cancel

    def cancel_late(robot: str, goal_id: str) -> None:
        all_asked.wait(PATIENCE_S)  # before any has an answer
        if robot == "r1":
            assert all(resting[name].wait(PATIENCE_S) for name in ("r2", "r3"))
        cancel(robot, goal_id)

    monkeypatch.setattr(lab.fleet, "cancel", cancel_late)
    dispatcher = lab.dispatcher()
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(dispatcher.run, lab.open_tests(r1=LONG, r2=LONG, r3=LONG))
        assert all(one.wait(PATIENCE_S) for one in moving.values())
        dispatcher.interrupt()
        with pytest.raises(Interrupted):
            running.result(PATIENCE_S)
    assert not all_asked.broken
    assert all(robot.at_rest for robot in lab.robots.values())


def test_ctrl_c_brings_all_robots_to_rest_stores_their_ends_and_is_raised_then(lab: Lab) -> None:
    moving = all_moving(lab)

    def press_ctrl_c() -> None:
        assert all(one.wait(PATIENCE_S) for one in moving.values())
        os.kill(os.getpid(), signal.SIGINT)

    pressing = threading.Thread(target=press_ctrl_c)
    pressing.start()
    with pytest.raises(KeyboardInterrupt):
        lab.dispatcher().run(lab.open_tests(r1=LONG, r2=LONG, r3=LONG))
    assert all(robot.at_rest for robot in lab.robots.values())
    pressing.join()
    trials = lab.studies.trials(STUDY)
    assert [(t.outcome, t.interrupted) for t in trials] == [(Outcome.CANCELLED, True)] * 3


def test_an_error_in_what_is_told_of_attempts_is_raised_with_all_robots_at_rest(lab: Lab) -> None:
    moving = all_moving(lab)

    def measure(references: FloatArray) -> FloatArray:
        assert all(moving[name].wait(PATIENCE_S) for name in ("r1", "r3"))
        raise RobotError("the gripper is open")

    def tell(*attempt: Any) -> None:
        raise BrokenPipeError("nobody reads this any more")

    lab.robots["r2"].measure = measure
    dispatcher = Dispatcher(lab.fleet, lab.log(), lab.specs, on_attempt_failed=tell)
    with pytest.raises(BrokenPipeError):
        dispatcher.run(lab.open_tests(r1=LONG, r2=TEST, r3=LONG))
    wait_until(lambda: all(robot.at_rest for robot in lab.robots.values()))
    assert [robot.motions for robot in lab.robots.values()] == [1, 1, 1]


def test_an_acceptance_is_stored_before_the_end_though_storing_it_takes_longer(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    ended = asked_about(lab, monkeypatch)
    log, stored = lab.log(), []
    accepted, ended_as = log.accepted, log.ended

    def store_slowly(test: OpenTest, *rest: Any) -> None:
        assert ended.wait(PATIENCE_S)
        accepted(test, *rest)
        stored.append("accepted")

    def store(test: OpenTest, *rest: Any) -> None:
        stored.append("ended")
        ended_as(test, *rest)

    monkeypatch.setattr(log, "accepted", store_slowly)
    monkeypatch.setattr(log, "ended", store)
    dispatcher = Dispatcher(lab.fleet, log, lab.specs, on_attempt_failed=lambda *a: None)
    dispatcher.run(lab.open_tests(r1=TEST))
    assert stored == ["accepted", "ended"]


# Robots that are not heard.


def test_a_state_from_before_its_goal_and_silence_after_it_lose_no_robot(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    ear, log = Ear(monkeypatch, "r1"), lab.log()
    asked = asked_about(lab, monkeypatch)
    ear.deaf = True
    wait_until(lambda: ear.has_missed(None))
    robot = lab.robots["r1"]
    robot.on_sample = lambda k: setattr(ear, "deaf", k < 160)
    accepted = log.accepted

    def stale(test: OpenTest, *rest: Any) -> None:
        ear.hear_late(None)
        accepted(test, *rest)

    monkeypatch.setattr(log, "accepted", stale)
    dispatcher = Dispatcher(lab.fleet, log, lab.specs, on_attempt_failed=lambda *a: None)
    outcome = dispatcher.run(lab.open_tests(r1=TEST))["r1"]
    assert isinstance(outcome, Measured)
    assert asked.is_set()
    assert (outcome.attempts, robot.motions) == (1, 1)


def test_a_robot_that_is_silent_in_the_middle_of_its_test_is_waited_for(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    ear, robot = Ear(monkeypatch, "r1"), lab.robots["r1"]
    asked = asked_about(lab, monkeypatch)

    def on_sample(k: int) -> None:
        if k == 50:
            asked.clear()
            ear.deaf = True
        if k > 50 and asked.is_set():
            ear.deaf = False

    robot.on_sample = on_sample
    outcome = lab.run(r1=SOME_SECONDS)["r1"]
    assert isinstance(outcome, Measured)
    assert (outcome.attempts, robot.motions) == (1, 1)


def test_a_robot_that_is_not_heard_is_cancelled_like_the_others(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    ear, moving = Ear(monkeypatch, "r1"), all_moving(lab)
    asked = asked_about(lab, monkeypatch)
    dispatcher = lab.dispatcher()
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(dispatcher.run, lab.open_tests(r1=LONG, r2=LONG))
        assert moving["r1"].wait(PATIENCE_S)
        assert moving["r2"].wait(PATIENCE_S)
        ear.deaf = True
        asked.clear()
        assert asked.wait(PATIENCE_S)  # it has been silent for too long
        dispatcher.interrupt()
        with pytest.raises(Interrupted):
            running.result(PATIENCE_S)
    assert all(robot.at_rest for robot in lab.robots.values())
    trials = lab.studies.trials(STUDY)
    assert [(t.outcome, t.interrupted) for t in trials] == [(Outcome.CANCELLED, True)] * 2
