"""Robots that take off, report their health, and can be killed: what their agents make of it."""

from __future__ import annotations

import threading

import pytest
from fleet_lab import SLOW, Gate, Lab, refusal, released
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Outcome, RobotStatus


def spec(**changes: object) -> RobotSpec:
    return puppet_spec().model_copy(update=changes)


def test_a_robot_begins_with_its_first_motion_and_not_with_its_agent(lab: Lab) -> None:
    robot = PuppetRobot()
    agent = lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    assert (robot.connected, robot.begun) == (True, 0)
    for goal in ("one", "two"):
        assert orchestrator.run("a", goal).outcome is Outcome.COMPLETED
    assert (robot.begun, robot.ended) == (1, 0)
    agent.close()
    assert (robot.begun, robot.ended, robot.connected) == (1, 1, False)


def test_an_idle_robot_is_ended_and_begins_again_with_the_next_motion(lab: Lab) -> None:
    robot = PuppetRobot(spec(idle_s=0.01))
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    for times, goal in enumerate(("one", "two"), start=1):
        assert orchestrator.run("a", goal).outcome is Outcome.COMPLETED
        wait_until(lambda times=times: robot.ended == times)
        assert robot.begun == times


def test_a_robot_that_was_stopped_before_it_began_does_not_take_off(lab: Lab) -> None:
    robot = PuppetRobot()
    gate = Gate(robot)
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    reached, goes_on = threading.Event(), threading.Event()

    def begins() -> None:
        reached.set()
        assert goes_on.wait(PATIENCE_S)

    robot.on_begin = begins
    gate.opened.set()
    orchestrator.submit("a", "one")
    assert reached.wait(PATIENCE_S)
    orchestrator.fleet.stop("a", "smoke")
    goes_on.set()
    assert orchestrator.result("a", "one").outcome is Outcome.ABORTED
    assert robot.samples == 0  # it took off before the stop, and did nothing more


def test_a_robot_that_cannot_begin_says_why_and_is_free_again(lab: Lab) -> None:
    robot = PuppetRobot()

    def no_gps() -> None:
        raise RobotError("no position estimate")

    robot.on_begin = no_gps
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    result = orchestrator.run("a", "one")
    assert (result.outcome, robot.samples, robot.ended) == (Outcome.FAILED, 0, 1)
    assert result.reason == "could not get ready to move: no position estimate"
    robot.on_begin = lambda: None
    assert orchestrator.run("a", "two").outcome is Outcome.COMPLETED


def test_a_robot_that_is_not_ready_or_too_empty_refuses_before_anything_moves(lab: Lab) -> None:
    robot = PuppetRobot()
    robot.reports = lambda: Health(battery=0.1, endurance_s=1.0)
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    state = orchestrator.state("a", lambda state: state.health is not None)
    assert state.health == robot.reports()
    assert refusal(lambda: orchestrator.submit("a", "long")) == "battery"
    robot.reports = lambda: Health(ready=False, reason="locked after a crash")
    state = orchestrator.state("a", lambda s: s.health is not None and not s.health.ready)
    assert state.reason == "locked after a crash"
    assert refusal(lambda: orchestrator.submit("a", "short")) == "not-ready"
    assert (robot.begun, robot.samples) == (0, 0)


def test_a_motion_ends_when_its_robot_is_no_longer_ready(lab: Lab) -> None:
    robot = PuppetRobot()
    robot.reports = Health
    lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    orchestrator.submit("a", "one", **SLOW)
    orchestrator.state("a", lambda state: state.progress > 0)
    robot.reports = lambda: Health(ready=False, reason="battery at 3.1 V")
    result = orchestrator.result("a", "one")
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "battery at 3.1 V")
    assert robot.at_rest


def test_a_killed_robot_is_asked_for_nothing_until_it_is_connected_again(lab: Lab) -> None:
    robot = PuppetRobot()
    cut = threading.Event()
    robot.on_kill = cut.set

    def sample(k: int) -> None:
        if cut.is_set():
            raise RobotDownError("the supervisor says: locked")

    robot.on_sample = sample
    lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    orchestrator.submit("a", "one", **SLOW)
    orchestrator.state("a", lambda state: state.progress > 0)
    asked: list[bool] = []
    robot.on_rest = robot.on_end = lambda: asked.append(cut.is_set())
    orchestrator.fleet.stop("a", "smoke", kill=True)
    orchestrator.state("a", lambda state: state.status is RobotStatus.FAULT)
    assert refusal(lambda: orchestrator.submit("a", "two")) == "fault"
    assert True not in asked  # but it may have been coming to rest when it was killed
    cut.clear()
    released(orchestrator.fleet, "a")
    assert orchestrator.run("a", "three").outcome is Outcome.COMPLETED
    assert robot.begun == 2


def test_a_robot_that_leaves_its_limits_comes_to_rest_and_lands_with_a_fault(lab: Lab) -> None:
    fenced = tuple(axis.model_copy(update={"output_max": 1.05}) for axis in puppet_spec().axes)
    robot = PuppetRobot(spec(axes=fenced))
    robot.measure = lambda references: references * 8
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    result = orchestrator.run("a", "one")
    assert result.outcome is Outcome.FAILED
    assert "is outside the limits of the robot, -inf to 1.05 m" in result.reason
    assert (robot.at_rest, robot.ended) == (True, 1)
    assert orchestrator.state("a", lambda s: s.goal_id is None).status is RobotStatus.FAULT


def test_an_agent_whose_robot_cannot_be_ended_says_so(lab: Lab) -> None:
    robot = PuppetRobot()
    agent = lab.agent("a", robot)
    assert lab.orchestrator().run("a", "one").outcome is Outcome.COMPLETED

    def stuck() -> None:
        raise RobotError("no ground in sight")

    robot.on_end = stuck
    with pytest.raises(RobotError, match="could not be ended: no ground in sight"):
        agent.close()
