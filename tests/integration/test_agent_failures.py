"""Agents whose robots fail, and agents, orchestrators and routers that come and go."""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np
import pytest
from fleet_lab import KEYS, SLOW, Lab, Orchestrator, refusal, released
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.robot_agent.agent import Agent
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import (
    NoReplyError,
    RefusedError,
    RobotError,
    RobotLostError,
    TransportError,
)
from nufleet.shared.wire.messages import Outcome, RobotStatus
from nufleet.shared.wire.transport import open_router

# Robots that fail.


def test_a_sensor_that_fails_fails_the_goal_with_the_samples_before(lab: Lab) -> None:
    robot = PuppetRobot()

    def measure(references: FloatArray) -> FloatArray:
        measured = references.copy()
        if robot.samples > 100:
            measured[-1] = np.nan
        return measured

    robot.measure = measure
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    result = orchestrator.run("a", "g1")
    assert result.outcome is Outcome.FAILED
    assert "not finite at sample" in result.reason
    assert 0 < len(result.response) < result.plan.samples
    robot.measure = np.copy
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


def test_a_robot_error_fails_the_goal_and_leaves_the_robot_in_service(lab: Lab) -> None:
    robot = PuppetRobot()

    def on_sample(k: int) -> None:
        if k == 50:
            raise RobotError("the gripper is open")

    robot.on_sample = on_sample
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    result = orchestrator.run("a", "g1")
    assert (result.outcome, result.reason) == (Outcome.FAILED, "the gripper is open")
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.IDLE)
    assert state.reason == "the gripper is open"
    robot.on_sample = lambda k: None
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


def broken_driver(robot: PuppetRobot) -> None:
    def on_sample(k: int) -> None:
        if k == 50:
            raise OSError("the serial line is gone", "\udcff" * 3000)

    robot.on_sample = on_sample


def stuck_brake(robot: PuppetRobot) -> None:
    def on_rest() -> None:
        raise RobotError("the serial line is gone" + "\udcff" * 3000)

    robot.on_rest = on_rest


@pytest.mark.parametrize("break_it", [broken_driver, stuck_brake])
def test_a_fault_refuses_goals_until_the_robot_is_connected_anew(
    lab: Lab, break_it: Callable[[PuppetRobot], None]
) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    fleet = orchestrator.fleet
    break_it(robot)
    result = orchestrator.run("a", "g1")
    assert result.outcome is Outcome.FAILED
    assert "the serial line is gone" in result.reason
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.FAULT)
    assert "the serial line is gone" in state.reason
    # It lives, it says so, and it refuses.
    orchestrator.state("a", lambda s: s.sequence >= state.sequence + 2)
    assert refusal(lambda: orchestrator.submit("a", "g2")) == "fault"
    motions = robot.motions

    def on_connect() -> None:
        raise RobotError("no such port")

    robot.on_connect = on_connect
    with pytest.raises(RefusedError, match="no such port") as raised:
        fleet.release("a")
    assert raised.value.code == "fault"
    assert refusal(lambda: orchestrator.submit("a", "g2")) == "fault"
    assert robot.motions == motions

    robot.on_connect = robot.on_rest = lambda: None
    robot.on_sample = lambda k: None
    fleet.release("a")
    orchestrator.state("a", lambda s: s.status is RobotStatus.IDLE)
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


def test_a_fault_does_not_undo_a_stop(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    orchestrator = lab.orchestrator()
    stuck_brake(robot)
    orchestrator.run("a", "g1")
    orchestrator.fleet.stop("a", "smoke")
    robot.on_rest = lambda: None
    assert orchestrator.state("a", lambda s: s.status is RobotStatus.FAULT)
    released(orchestrator.fleet, "a")
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


# Coming and going.


def test_a_late_joiner_sees_the_state_of_every_robot(running_fleet: Orchestrator, lab: Lab) -> None:
    running_fleet.run("r0", "g")
    running_fleet.fleet.stop("r1", "smoke")
    late = lab.orchestrator("late")
    assert late.fleet.robots() == ("r0", "r1", "r2")
    assert late.state("r0", lambda s: True).last_goal_id == "g"
    assert late.state("r1", lambda s: True).status is RobotStatus.STOPPED
    assert late.state("r2", lambda s: True).status is RobotStatus.IDLE


def test_who_does_not_come_is_named_with_those_who_are_there(running_fleet: Orchestrator) -> None:
    with pytest.raises(
        RobotLostError, match=r"robot r9 did not appear .* robots present: r0, r1, r2"
    ):
        running_fleet.fleet.wait_for(("r0", "r9"), timeout_s=0.05)
    with pytest.raises(NoReplyError, match="robot r9 does not answer"):
        running_fleet.fleet.describe("r9")


def test_an_agent_that_ends_during_a_motion_leaves_its_robot_at_rest(lab: Lab) -> None:
    robot = PuppetRobot()
    agent = lab.agent("a", robot, realtime=1.0)
    orchestrator = lab.orchestrator()
    states: list[RobotStatus] = []
    orchestrator.fleet.observe_states(lambda state: states.append(state.status))
    orchestrator.submit("a", "g", **SLOW)
    wait_until(lambda: not robot.at_rest)
    agent.close()
    assert robot.at_rest
    assert not robot.connected
    assert not [t.name for t in threading.enumerate() if t.name.startswith("a-")]
    watch = orchestrator.fleet.watch("a")
    assert watch.wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S)
    wait_until(lambda: bool(states) and states[-1] is RobotStatus.IDLE)
    assert watch.state is not None
    assert watch.state.reason == "the agent is shutting down"
    with pytest.raises(NoReplyError):
        orchestrator.fleet.describe("a")
    agent.close()


def test_a_robot_that_cannot_be_left_at_rest_is_an_error_of_the_agent_that_leaves(lab: Lab) -> None:
    robot = PuppetRobot()

    def on_disconnect() -> None:
        raise RobotError("the brake is stuck")

    robot.on_disconnect = on_disconnect
    agent = lab.agent("a", robot)
    with pytest.raises(RobotError, match="the brake is stuck"):
        agent.close()
    assert not [t.name for t in threading.enumerate() if t.name.startswith("a-")]


def test_an_agent_that_cannot_begin_leaves_nothing_behind(lab: Lab) -> None:
    robot = PuppetRobot()

    def on_connect() -> None:
        raise RobotError("no such port")

    robot.on_connect = on_connect
    orchestrator = lab.orchestrator()
    with pytest.raises(RobotError, match="no such port"):
        lab.agent("a", robot)
    robot.on_connect = lambda: None
    closed = lab.session()
    closed.close()
    with pytest.raises(TransportError), Agent(closed, KEYS, "a", robot, realtime=None):
        pass
    assert not robot.connected
    assert not [t.name for t in threading.enumerate() if t.name.startswith("a-")]
    assert orchestrator.session.alive(KEYS.every_robot("alive"), timeout_s=PATIENCE_S) == []


def test_a_restarted_agent_is_known_by_its_boot_id_and_by_nothing_of_the_goals_before(
    lab: Lab,
) -> None:
    first = lab.agent("a", PuppetRobot())
    orchestrator = lab.orchestrator()
    boot_id = orchestrator.run("a", "g").boot_id
    first.close()
    lab.agent("a", PuppetRobot())
    state = orchestrator.next_life("a", boot_id)
    assert state.last_goal_id is None
    assert refusal(lambda: orchestrator.fleet.result("a", "g")) == "unknown-goal"


def test_everything_heals_after_a_restart_of_the_router(lab: Lab, endpoint: str) -> None:
    robot = PuppetRobot()
    second = f"{endpoint}2"
    own = Lab(second, lab.stack)
    with open_router([second]):
        own.agent("a", robot, realtime=1.0)
        orchestrator = own.orchestrator()
        orchestrator.submit("a", "g1", **SLOW)
        wait_until(lambda: not robot.at_rest)
    # Cut off from its owner, the robot rests by itself.
    wait_until(lambda: robot.at_rest)
    with open_router([second]):
        result = orchestrator.result("a", "g1")
        assert result.outcome is Outcome.ABORTED
        wait_until(lambda: orchestrator.fleet.robots() == ("a",))
        orchestrator.submit("a", "g2", **SLOW)
        orchestrator.fleet.cancel("a", "g2")
        assert orchestrator.result("a", "g2").outcome is Outcome.CANCELLED
        lab.stack.close()
