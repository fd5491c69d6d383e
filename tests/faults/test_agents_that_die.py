"""Agents that are killed and frozen: noticed in time, and no goal moves its robot twice."""

from __future__ import annotations

import threading
import time
from concurrent.futures import ThreadPoolExecutor

import pytest
from fleet_lab import submitted

from benchmarks.faults.lab import KEYS, Lab
from benchmarks.faults.program import PATIENCE_S, Program, wait_until
from nufleet.orchestrator.fleet import goal_pursuit
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.robot_agent.network.endpoint import SHUTTING_DOWN
from nufleet.shared.errors import NoReplyError, RobotLostError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.messages import GoalRequest, Outcome, RobotStatus
from nufleet.shared.wire.requests import Request
from nufleet.shared.wire.transport import open_client

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)
LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)


def goal(fleet: Fleet, goal_id: str, motion: Excitation) -> GoalRequest:
    return GoalRequest(goal_id=goal_id, owner=fleet.orchestrator_id, motion=motion)


def wait_for_motion(lab: Lab, robot: str, number: int) -> None:
    wait_until(lambda: len(lab.motions(robot)) == number)


@pytest.fixture
def agent(lab: Lab) -> Program:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    return lab.agent("a", realtime=1.0)


def test_a_killed_agent_is_noticed_at_once_with_robot_and_goal(
    lab: Lab, agent: Program, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(goal_pursuit, "RETURN_PATIENCE_S", 2.0)
    fleet = lab.orchestrator("a")
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(GoalRunner(fleet).run, "a", "g", LONG)
        wait_for_motion(lab, "a", 1)
        agent.kill()
        assert fleet.watch("a").wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S)
        # The latter when it had not answered yet.
        words = r"robot a .* (during g|goal g)\b"
        with pytest.raises((RobotLostError, NoReplyError), match=words):
            running.result(PATIENCE_S)


def test_a_goal_that_an_agent_died_of_is_never_played_again(lab: Lab, agent: Program) -> None:
    fleet = lab.orchestrator("a")
    request = goal(fleet, "g", LONG)
    accepted = submitted(fleet, "a", request)
    boot_id = accepted.boot_id
    for life in range(1, 3):
        wait_for_motion(lab, "a", 1)
        for _ in range(25):
            fleet.submit("a", request)
        agent.kill()
        agent.start()
        state = lab.wait_for_state(fleet, "a", lambda s: s.boot_id != boot_id)  # noqa: B023
        boot_id = state.boot_id
        # It says which goal was lost, and knows it when it is sent again.
        assert state.last_goal_id == "g" or life > 1
        fleet.wait_for(("a",), timeout_s=PATIENCE_S)
        for _ in range(25):
            fleet.submit("a", request)
        lost = fleet.result("a", "g")
        assert lost.outcome is Outcome.LOST, lost
        assert lost.boot_id == accepted.boot_id
        assert "ended during it; send a new attempt" in lost.reason
    assert GoalRunner(fleet).run("a", "g2", SHORT).outcome is Outcome.COMPLETED
    assert len(lab.motions("a")) == 2


def test_a_frozen_agent_is_given_up_and_rests_when_it_wakes(lab: Lab, agent: Program) -> None:
    fleet = lab.orchestrator("a")
    accepted = submitted(fleet, "a", goal(fleet, "g", LONG))
    wait_for_motion(lab, "a", 1)
    agent.freeze()
    frozen_s = time.monotonic()
    # How soon is measured by `python -m benchmarks.faults detection`.
    assert fleet.watch("a").wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S)
    wait_until(lambda: time.monotonic() - frozen_s > 2.5)
    agent.thaw()
    lab.wait_for_state(fleet, "a", lambda state: state.last_goal_id == "g")
    fleet.wait_for(("a",), timeout_s=PATIENCE_S)
    result = fleet.result("a", "g")
    assert result.outcome is Outcome.ABORTED
    assert result.boot_id == accepted.boot_id
    assert result.reason
    (motion,) = lab.motions("a")
    assert motion.ended_s is not None
    # It serves on, and says the same of that goal whenever it is asked again.
    fleet.submit("a", goal(fleet, "g", LONG))
    assert GoalRunner(fleet).run("a", "g2", SHORT).outcome is Outcome.COMPLETED
    assert fleet.result("a", "g").outcome is Outcome.ABORTED
    assert len(lab.motions("a")) == 2


def test_an_agent_that_was_frozen_while_its_owner_died_rests_when_it_wakes(
    lab: Lab, agent: Program
) -> None:
    watcher = lab.orchestrator("a", name="watcher")
    with lab.joined("a", name="owner") as fleet:
        submitted(fleet, "a", goal(fleet, "g", LONG))
        wait_for_motion(lab, "a", 1)
        agent.freeze()
    agent.thaw()
    state = lab.wait_for_state(watcher, "a", lambda state: state.last_goal_id == "g")
    assert state.status is RobotStatus.IDLE
    watcher.wait_for(("a",), timeout_s=PATIENCE_S)
    assert watcher.result("a", "g").outcome is Outcome.ABORTED


def test_an_agent_that_is_being_restarted_takes_a_goal_when_it_is_back(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A busy machine may take long to start a process.
    monkeypatch.setattr(goal_pursuit, "RETURN_PATIENCE_S", PATIENCE_S)
    lab.describe_section_v({"a": 0.9})
    lab.router()
    asked = threading.Event()

    def ending(request: Request) -> None:
        request.answer(encode(SHUTTING_DOWN))
        asked.set()

    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session, ThreadPoolExecutor(1) as pool:
        session.serve(KEYS.command("a", "orchestrator-1", "goal"), ending)
        session.declare_alive(KEYS.robot("a", "alive"))
        fleet = lab.orchestrator("a")
        running = pool.submit(GoalRunner(fleet).run, "a", "g", SHORT)
        assert asked.wait(PATIENCE_S)
        session.close()
        lab.agent("a")
        assert running.result(PATIENCE_S).outcome is Outcome.COMPLETED
    assert len(lab.motions("a")) == 1
