"""Agents of one process are closed together: none waits for another one's robot or driver."""

from __future__ import annotations

import threading
from contextlib import ExitStack
from typing import Any

import pytest
from fleet_lab import KEYS, SLOW, Lab
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.motion.watched_robot import WatchedRobot
from nufleet.robot_agent.serve import closed_together
from nufleet.shared.errors import RobotError


def serve_and_close(lab: Lab, robots: dict[str, PuppetRobot]) -> None:
    with closed_together() as agents:
        for name, robot in robots.items():
            agents.append(Agent(lab.session(), KEYS, name, robot, realtime=1.0).__enter__())


def test_robots_halt_together_and_are_let_go_of_while_one_still_lands(lab: Lab) -> None:
    robots = {name: PuppetRobot() for name in ("a", "b", "c")}
    all_rest = threading.Barrier(len(robots), timeout=PATIENCE_S)
    others_are_let_go = threading.Event()

    def land_last() -> None:
        all_rest.wait()
        assert others_are_let_go.wait(PATIENCE_S)

    robots["a"].on_rest = land_last
    robots["b"].on_rest = robots["c"].on_rest = all_rest.wait
    left = {"b", "c"}
    for name in ("b", "c"):

        def let_go(name: str = name) -> None:
            left.discard(name)
            if not left:
                others_are_let_go.set()

        robots[name].on_disconnect = let_go
    with closed_together() as agents:
        for name, robot in robots.items():
            agents.append(Agent(lab.session(), KEYS, name, robot, realtime=1.0).__enter__())
        orchestrator = lab.orchestrator("orchestrator-1", *robots)
        for name in robots:
            orchestrator.submit(name, f"goal-{name}", **SLOW)
            orchestrator.state(name, lambda state: state.progress > 0)
    assert not any(robot.connected for robot in robots.values())


def test_a_driver_that_does_not_let_go_is_named_and_keeps_no_other_robot(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    returns, calling = threading.Event(), WatchedRobot._calling
    robots = {name: PuppetRobot() for name in ("a", "b")}

    def impatiently(watched: WatchedRobot, what: str, allowed_s: float, **more: bool) -> Any:
        lets_go = watched._robot is robots["a"] and what == "disconnect"
        return calling(watched, what, 0.3 if lets_go else allowed_s, **more)

    monkeypatch.setattr(WatchedRobot, "_calling", impatiently)
    robots["a"].on_disconnect = lambda: returns.wait(PATIENCE_S) and None
    with ExitStack() as stack:
        stack.callback(wait_until, lambda: not robots["a"].connected)
        stack.callback(returns.set)
        with pytest.raises(RobotError, match=r"^a: .*'disconnect'.*the robot may not be at rest$"):
            serve_and_close(lab, robots)
        assert not robots["b"].connected
        assert robots["a"].connected


def test_every_robot_that_may_not_be_at_rest_is_named(lab: Lab) -> None:
    robots = {name: PuppetRobot() for name in ("a", "b", "c")}

    def lost() -> None:
        raise RobotError("the radio is gone")

    robots["a"].on_disconnect = robots["c"].on_disconnect = lost
    with pytest.raises(RobotError, match=r"^a: the radio is gone; c: the radio is gone$"):
        serve_and_close(lab, robots)
    assert not robots["b"].connected
