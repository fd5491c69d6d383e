"""A stop reaches robots that are busy or whose owner is dead, and lasts; a failed one is told."""

from __future__ import annotations

import pytest
from fleet_lab import submitted

from benchmarks.faults.lab import Lab
from benchmarks.faults.program import PATIENCE_S, Program, wait_until
from nufleet.orchestrator.jobs.stop import stop_robots
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest, Outcome, RobotStatus

LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)
ROBOTS = ("a", "b", "c")


def submit_to_all(lab: Lab, goal_id: str, owner: str = "orchestrator-1") -> None:
    fleet = lab.orchestrator(*ROBOTS, name=owner)
    for robot in ROBOTS:
        submitted(fleet, robot, GoalRequest(goal_id=goal_id, owner=owner, motion=LONG))
        lab.wait_for_state(fleet, robot, lambda state: state.progress > 0)


@pytest.fixture
def agent(lab: Lab) -> Program:
    lab.describe_section_v(dict.fromkeys(ROBOTS, 0.9))
    lab.router()
    return lab.agent(*ROBOTS, realtime=1.0)


def test_a_stop_of_all_halts_every_motion_and_outlasts_a_crash(lab: Lab, agent: Program) -> None:
    submit_to_all(lab, "g")
    boots = {}
    with lab.joined(*ROBOTS, name="desk") as fleet:
        fleet.stop_everyone("smoke")
        assert stop_robots(fleet, ROBOTS, "smoke") == {}
        for robot in ROBOTS:
            state = lab.wait_for_state(fleet, robot, lambda s: s.last_goal_id == "g")
            boots[robot] = state.boot_id
            result = fleet.result(robot, "g")
            assert (result.outcome, result.reason) == (
                Outcome.ABORTED,
                "stopped by desk: smoke",
            )
        agent.kill()
        agent.start()
        for robot in ROBOTS:
            state = lab.wait_for_state(fleet, robot, lambda s: s.boot_id != boots[robot])  # noqa: B023
            assert state.status is RobotStatus.STOPPED
            assert state.reason == "stopped by desk: smoke"
        fleet.wait_for(ROBOTS, timeout_s=PATIENCE_S)
        # A second stop is accepted, and a goal is refused with what to do.
        assert stop_robots(fleet, ROBOTS, "again") == {}
        request = GoalRequest(goal_id="g2", owner="desk", motion=LONG)
        with pytest.raises(
            RefusedError,
            match="release it first with `nufleet release`: it was stopped by desk",
        ):
            submitted(fleet, "a", request)
    assert all(len(lab.motions(robot)) == 1 for robot in ROBOTS)


def test_a_stop_that_does_not_arrive_is_shouted(lab: Lab, agent: Program) -> None:
    fleet = lab.orchestrator(*ROBOTS)
    submitted(fleet, "a", GoalRequest(goal_id="g", owner=fleet.orchestrator_id, motion=LONG))
    wait_until(lambda: len(lab.motions("a")) == 1)
    agent.freeze()
    stop = lab.command("stop", "a", "b", "--connect", lab.endpoint, "--fleet-name", "lab")
    assert stop.wait() == 1
    for robot in ("a", "b"):
        assert f"{robot} DID NOT CONFIRM ITS STOP" in stop.said
    assert "Stop these robots by hand" in stop.said
    agent.thaw()
    # It rests by itself when it wakes, and can then be stopped.
    lab.wait_for_state(fleet, "a", lambda state: state.last_goal_id == "g")
    (motion,) = lab.motions("a")
    assert motion.ended_s is not None
    fleet.wait_for(ROBOTS, timeout_s=PATIENCE_S)
    assert stop_robots(fleet, ROBOTS, "smoke") == {}


def test_a_frozen_agent_keeps_no_other_from_being_stopped_and_saying_so(lab: Lab) -> None:
    lab.describe_section_v(dict.fromkeys(ROBOTS, 0.9))
    lab.router()
    frozen = lab.agent("c", realtime=1.0)
    lab.agent("a", "b", realtime=1.0)
    submit_to_all(lab, "g")
    frozen.freeze()
    try:
        stop = lab.command("stop", *ROBOTS, "--connect", lab.endpoint)
        assert stop.wait() == 1
        assert "c DID NOT CONFIRM ITS STOP" in stop.said
        for robot in ("a", "b"):
            assert f"{robot} is stopped" in stop.said
            wait_until(lambda: lab.motions(robot)[0].ended_s is not None)  # noqa: B023
    finally:
        frozen.thaw()


def test_a_stop_reaches_robots_whose_orchestrator_was_killed(lab: Lab, agent: Program) -> None:
    fleet = lab.orchestrator(*ROBOTS, name="watcher")
    owner = lab.owner("a", "first", 1, connect=lab.endpoint)
    lab.wait_for_state(fleet, "a", lambda state: state.progress > 0)
    owner.kill()
    stop = lab.command("stop", "--all", "--connect", lab.endpoint, "--fleet-name", "lab")
    assert stop.wait() == 0, stop.said
    for robot in ROBOTS:
        assert f"{robot} is stopped" in stop.said
        lab.wait_for_state(fleet, robot, lambda state: state.status is RobotStatus.STOPPED)
    state = lab.wait_for_state(fleet, "a", lambda state: state.last_goal_id == "first.1")
    assert state.goal_id is None
    assert fleet.result("a", "first.1").outcome is Outcome.ABORTED
    assert agent.running
    (motion,) = lab.motions("a")
    assert motion.ended_s is not None
