"""What an agent that restarts with the same state folder knows of its predecessor."""

from __future__ import annotations

from pathlib import Path

import pytest
from fleet_lab import KEYS, SLOW, Lab, Orchestrator, refusal, released
from polling import PATIENCE_S
from puppet_robot import PuppetRobot

from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.journal.journal import LOG, JournalInUseError
from nufleet.shared.wire.messages import Outcome, RobotStatus
from nufleet.shared.wire.transport import open_client


def begin_anew(lab: Lab, orchestrator: Orchestrator, robot: PuppetRobot, folder: Path) -> Agent:
    """Start another agent of the same robot, and wait until the orchestrator can reach it."""
    before = orchestrator.state("a", lambda s: True).boot_id
    agent = lab.agent("a", robot, state_folder=folder)
    orchestrator.next_life("a", before)
    return agent


def test_a_stop_outlasts_the_agent_until_it_is_released(lab: Lab, tmp_path: Path) -> None:
    agent = lab.agent("a", PuppetRobot(), realtime=1.0, state_folder=tmp_path / "a")
    orchestrator = lab.orchestrator()
    orchestrator.submit("a", "g1", **SLOW)
    orchestrator.fleet.stop("a", "smoke")
    for _ in range(2):
        agent.close()
        agent = begin_anew(lab, orchestrator, PuppetRobot(), tmp_path / "a")
        state = orchestrator.state("a", lambda s: True)
        assert state.status is RobotStatus.STOPPED
        assert state.reason == "stopped by orchestrator-1: smoke"
        assert refusal(lambda: orchestrator.submit("a", "g2")) == "stopped"
    released(orchestrator.fleet, "a")
    agent.close()
    begin_anew(lab, orchestrator, PuppetRobot(), tmp_path / "a")
    assert orchestrator.state("a", lambda s: True).status is RobotStatus.IDLE
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


def test_goals_and_results_outlast_the_agent_and_nothing_moves_twice(
    lab: Lab, tmp_path: Path
) -> None:
    agent = lab.agent("a", PuppetRobot(), state_folder=tmp_path / "a")
    orchestrator = lab.orchestrator()
    before = orchestrator.run("a", "g1")
    orchestrator.run("a", "g2")
    orchestrator.fleet.acknowledge("a", ("g2",))
    agent.close()
    robot = PuppetRobot()
    begin_anew(lab, orchestrator, robot, tmp_path / "a")
    after = orchestrator.fleet.result("a", "g1")
    assert after.response.tobytes() == before.response.tobytes()
    assert (after.outcome, after.boot_id) == (Outcome.COMPLETED, before.boot_id)
    assert refusal(lambda: orchestrator.fleet.result("a", "g2")) == "result-gone"
    for goal_id in ("g1", "g2"):
        orchestrator.submit("a", goal_id)
        assert refusal(lambda g=goal_id: orchestrator.submit("a", g, axis="y")) == "goal-id-reused"  # type: ignore[misc]
    assert orchestrator.run("a", "g3").outcome is Outcome.COMPLETED
    assert robot.motions == 1


def test_a_second_agent_of_one_robot_ends_with_an_error_and_touches_nothing(
    lab: Lab, tmp_path: Path
) -> None:
    lab.agent("a", PuppetRobot(), state_folder=tmp_path / "a")
    orchestrator = lab.orchestrator()
    other = PuppetRobot()
    other.on_connect = lambda: pytest.fail("two agents reached for one robot")
    with (
        open_client(lab.endpoint, timeout_s=PATIENCE_S) as session,
        pytest.raises(JournalInUseError, match="another agent serves this robot; end one of them"),
        Agent(session, KEYS, "a", other, realtime=None, state_folder=tmp_path / "a"),
    ):
        pass
    assert orchestrator.run("a", "g").outcome is Outcome.COMPLETED


def test_an_agent_with_an_altered_journal_serves_a_robot_that_is_stopped(
    lab: Lab, tmp_path: Path
) -> None:
    agent = lab.agent("a", PuppetRobot(), state_folder=tmp_path / "a")
    orchestrator = lab.orchestrator()
    orchestrator.run("a", "g1")
    agent.close()
    log = tmp_path / "a" / "journal" / LOG
    data = bytearray(log.read_bytes())
    data[100] ^= 1
    log.write_bytes(data)
    begin_anew(lab, orchestrator, PuppetRobot(), tmp_path / "a")
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    assert "altered" in state.reason
    orchestrator.fleet.release("a")
    assert orchestrator.run("a", "g2").outcome is Outcome.COMPLETED


def test_a_goal_that_cannot_be_stored_is_refused_and_moves_nothing(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot, state_folder=tmp_path / "a")
    orchestrator = lab.orchestrator()

    def broken(*_: object) -> None:
        raise OSError(5, "Input/output error")

    with monkeypatch.context() as disk:
        disk.setattr("os.fdatasync", broken)
        assert refusal(lambda: orchestrator.submit("a", "g1")) == "journal"
        # It halts all the same, and says that this would not outlast it.
        assert refusal(lambda: orchestrator.fleet.stop("a", "smoke")) == "journal"
        orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    assert robot.motions == 0
