"""Rounds of tests on real agents over a real router: parallel, repeated, interrupted."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest
from puppet_robot import PuppetRobot

from orchestrator.dispatcher import ATTEMPTS, Dispatcher, Failed, Interrupted, Measured
from orchestrator.fleet import Fleet
from robot_agent.agent import Agent
from shared.arrays import FloatArray
from shared.errors import RobotError
from shared.excitation import Excitation, Tone
from shared.keys import FleetKeys
from shared.transport import open_client, open_router

KEYS = FleetKeys("lab")
ROBOTS = ("r1", "r2", "r3")
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),))


@dataclass
class Lab:
    """A router, three agents and a client, all in this process."""

    endpoint: str
    robots: dict[str, PuppetRobot]
    fleet: Fleet
    stack: ExitStack
    attempts: list[tuple[str, int, str]] = field(default_factory=list)

    def dispatcher(self) -> Dispatcher:
        return Dispatcher(self.fleet, on_attempt_failed=lambda *a: self.attempts.append(a))


def start_lab(stack: ExitStack, tmp_path: Path, realtime: float | None) -> Lab:
    endpoint = f"unixsock-stream/{tmp_path}/r.sock"
    stack.enter_context(open_router([endpoint]))
    robots = {name: PuppetRobot() for name in ROBOTS}
    for name, robot in robots.items():
        session = stack.enter_context(open_client(endpoint, timeout_s=5.0))
        stack.enter_context(Agent(session, KEYS, name, robot, realtime=realtime))
    client = stack.enter_context(open_client(endpoint, timeout_s=5.0))
    fleet = Fleet(client, KEYS, "orchestrator-test")
    fleet.wait_for(ROBOTS, timeout_s=10.0)
    return Lab(endpoint, robots, fleet, stack)


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield start_lab(stack, tmp_path, realtime=None)


@pytest.fixture
def slow_lab(tmp_path: Path) -> Iterator[Lab]:
    with ExitStack() as stack:
        yield start_lab(stack, tmp_path, realtime=1.0)


def test_a_round_measures_every_robot_once(lab: Lab) -> None:
    outcomes = lab.dispatcher().run("round", dict.fromkeys(ROBOTS, TEST))
    assert set(outcomes) == set(ROBOTS)
    for outcome in outcomes.values():
        assert isinstance(outcome, Measured)
        assert outcome.response.z[0] == pytest.approx(1.0, abs=1e-9)
        assert outcome.robot_time_s == pytest.approx(outcome.result.plan.duration_s)
    assert [robot.motions for robot in lab.robots.values()] == [1, 1, 1]
    assert not lab.attempts


def test_the_same_round_sent_again_moves_no_robot_twice(lab: Lab) -> None:
    first = lab.dispatcher().run("round", dict.fromkeys(ROBOTS, TEST))
    second = lab.dispatcher().run("round", dict.fromkeys(ROBOTS, TEST))
    assert [robot.motions for robot in lab.robots.values()] == [1, 1, 1]
    for robot in ROBOTS:
        one, other = first[robot], second[robot]
        assert isinstance(one, Measured)
        assert isinstance(other, Measured)
        assert one.result.goal_id == other.result.goal_id


def test_robots_of_a_round_move_at_the_same_time(slow_lab: Lab) -> None:
    together = threading.Barrier(len(ROBOTS), timeout=10.0)
    for robot in slow_lab.robots.values():
        robot.on_sample = lambda k: together.wait() if k == 5 else None  # type: ignore[assignment, return-value]
    outcomes = slow_lab.dispatcher().run("round", dict.fromkeys(ROBOTS, TEST))
    assert all(isinstance(outcome, Measured) for outcome in outcomes.values())


def test_an_unusable_test_is_repeated_with_more_time(lab: Lab) -> None:
    robot = lab.robots["r1"]
    batches: list[int] = []

    def broken_first_time(references: FloatArray) -> FloatArray:
        batches.append(len(references))
        return np.zeros_like(references) if robot.motions == 1 else references.copy()

    robot.measure = broken_first_time
    outcome = lab.dispatcher().run("round", {"r1": TEST})["r1"]
    assert isinstance(outcome, Measured)
    assert outcome.attempts == 2
    assert outcome.robot_time_s > outcome.result.plan.duration_s
    ((name, attempt, reason),) = lab.attempts
    assert (name, attempt) == ("r1", 1)
    assert reason


def test_a_robot_that_keeps_failing_is_given_up_with_the_reason(lab: Lab) -> None:
    def broken(references: FloatArray) -> FloatArray:
        raise RobotError("the motor driver reports overheating")

    lab.robots["r2"].measure = broken
    outcomes = lab.dispatcher().run("round", dict.fromkeys(ROBOTS, TEST))
    failed = outcomes["r2"]
    assert isinstance(failed, Failed)
    assert "overheating" in failed.reason
    assert failed.attempts <= ATTEMPTS
    assert isinstance(outcomes["r1"], Measured)
    assert isinstance(outcomes["r3"], Measured)


def test_a_refusal_is_not_asked_again(lab: Lab) -> None:
    too_fast = Excitation(axis="x", tones=(Tone(omega_rad_s=49.0),), amplitude=100.0)
    outcome = lab.dispatcher().run("round", {"r1": too_fast})["r1"]
    assert isinstance(outcome, Failed)
    assert outcome.attempts == 1
    assert "amplitude" in outcome.reason
    assert lab.robots["r1"].motions == 0


def test_an_interrupted_round_leaves_every_robot_at_rest(slow_lab: Lab) -> None:
    long_test = Excitation(axis="x", tones=(Tone(omega_rad_s=0.5),))
    dispatcher = slow_lab.dispatcher()
    threading.Thread(
        target=lambda: (
            slow_lab.fleet.watch("r1").wait_until(
                lambda w: w.state is not None and w.state.progress > 0, timeout_s=10.0
            ),
            dispatcher.interrupt(),
        )
    ).start()
    began_s = time.monotonic()
    with pytest.raises(Interrupted):
        dispatcher.run("round", dict.fromkeys(ROBOTS, long_test))
    assert time.monotonic() - began_s < 10.0
    for name in ROBOTS:
        watch = slow_lab.fleet.watch(name)
        assert watch.wait_until(
            lambda w: w.state is not None and w.state.goal_id is None, timeout_s=5.0
        )
        assert slow_lab.robots[name].at_rest


def test_a_robot_that_comes_back_after_its_agent_died_is_tested_again(lab: Lab) -> None:
    endpoint = lab.endpoint
    began = threading.Event()
    agents: list[ExitStack] = []

    def start(robot: PuppetRobot) -> None:
        stack = ExitStack()
        session = stack.enter_context(open_client(endpoint, timeout_s=5.0))
        stack.enter_context(Agent(session, KEYS, "r9", robot, realtime=1.0))
        agents.append(stack)

    first, second = PuppetRobot(), PuppetRobot()
    first.on_sample = lambda k: began.set()
    start(first)
    lab.fleet.wait_for(("r9",), timeout_s=5.0)

    def kill_and_restart() -> None:
        began.wait(10.0)
        agents.pop().close()
        start(second)

    replacement = threading.Thread(target=kill_and_restart)
    replacement.start()
    try:
        outcome = lab.dispatcher().run("round", {"r9": TEST})["r9"]
        replacement.join()
    finally:
        for stack in agents:
            stack.close()
    assert isinstance(outcome, Measured)
    assert outcome.attempts == 2
    assert (first.motions, second.motions) == (1, 1)
