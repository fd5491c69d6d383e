"""Two orchestrators and one robot: who commands it, over a real router."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_processes import Typed
from fleet_lab import SLOW, Lab, Orchestrator, refusal, submitted
from polling import wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.repository.errors import EpochOutOfRangeError
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.robot_agent.journal.journal import Journal
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.wire.messages import GoalAccepted, Outcome, RobotStatus

LAB = """
schema = 1
name = "lab"
description = "one robot"
[robots.a]
driver = "double_integrator"
settings = { alpha = 0.9, beta = 0.003 }
"""


def submit(
    orchestrator: Orchestrator, goal_id: str, epoch: int, **excitation: object
) -> GoalAccepted:
    request = orchestrator.request(goal_id, **excitation)
    return submitted(orchestrator.fleet, "a", request.model_copy(update={"epoch": epoch}))


def test_everyone_can_see_who_commands_a_robot_and_under_which_epoch(lab: Lab) -> None:
    lab.agent("a", PuppetRobot())
    owner, watcher = lab.orchestrator("owner"), lab.orchestrator("watcher")
    described = watcher.fleet.describe("a")
    assert (described.owner, described.epoch) == (None, 0)
    request = owner.request("g")
    assert isinstance(request.motion, Excitation)
    owner.fleet.hold({"a": 5})
    result = GoalRunner(owner.fleet).run("a", "g", request.motion)
    assert result.outcome is Outcome.COMPLETED
    described = watcher.fleet.describe("a")
    assert (described.owner, described.epoch) == ("owner", 5)
    assert watcher.fleet.result("a", "g").outcome is Outcome.COMPLETED


def test_an_epoch_that_is_over_is_refused_in_everything_and_names_the_newer_owner(
    lab: Lab, tmp_path: Path
) -> None:
    robot = PuppetRobot()
    agent = lab.agent("a", robot, state_folder=tmp_path / "a")
    late, owner = lab.orchestrator("late"), lab.orchestrator("owner")
    submit(owner, "g", 5)
    owner.result("a", "g")
    for life in range(2):
        with pytest.raises(RefusedError, match="owner commands it under epoch 5") as raised:
            submit(late, "g2", 4)
        assert raised.value.code == "stale-epoch"
        assert refusal(lambda: submit(late, "g2", 5)) == "stale-epoch"
        assert refusal(lambda: submit(late, "g", 4)) == "stale-epoch"
        fleet = late.fleet
        fleet.hold({"a": 4})
        assert refusal(lambda: fleet.acknowledge("a", ("g",))) == "stale-epoch"  # noqa: B023
        assert refusal(lambda: fleet.cancel("a", "g")) == "stale-epoch"  # noqa: B023
        assert refusal(lambda: fleet.remove_prior("a")) == "stale-epoch"  # noqa: B023
        sent = ("prior", b"", "0" * 64)
        assert refusal(lambda: fleet.install("a", *sent)) == "stale-epoch"  # type: ignore[arg-type]  # noqa: B023
        assert owner.fleet.result("a", "g").outcome is Outcome.COMPLETED
        if life == 0:
            boot_id = owner.state("a", lambda s: True).boot_id
            agent.close()
            agent = lab.agent("a", robot, state_folder=tmp_path / "a")
            late.next_life("a", boot_id)
            owner.next_life("a", boot_id)
    assert robot.motions == 1


def test_a_higher_epoch_takes_over_a_robot_at_rest_and_no_moving_one(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot, realtime=1.0)
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    submit(first, "g1", 5, **SLOW)
    wait_until(lambda: not robot.at_rest)
    assert refusal(lambda: submit(second, "g2", 6)) == "busy"
    second.fleet.hold({"a": 6})
    assert refusal(lambda: second.fleet.cancel("a", "g1")) == "busy"
    first.state("a", lambda s: s.status is RobotStatus.RUNNING)
    first.fleet.hold({"a": 5})
    first.fleet.cancel("a", "g1")
    first.result("a", "g1")
    submit(second, "g2", 6, **SLOW)
    assert refusal(lambda: first.fleet.cancel("a", "g2")) == "stale-epoch"
    assert second.fleet.describe("a").owner == "second"
    # A stop is everybody's.
    first.fleet.stop("a", "smoke")
    assert second.result("a", "g2").outcome is Outcome.ABORTED


def test_a_robot_whose_owner_falls_silent_rests_and_can_be_taken_over(lab: Lab) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot, realtime=1.0)
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    submit(first, "g1", 5, **SLOW)
    wait_until(lambda: not robot.at_rest)
    first.session.close()
    result = second.result("a", "g1")
    assert (result.outcome, result.reason) == (Outcome.ABORTED, "its owner first is gone")
    submit(second, "g2", 6)
    assert second.result("a", "g2").outcome is Outcome.COMPLETED
    awake = lab.orchestrator("first")
    assert refusal(lambda: submit(awake, "g3", 5)) == "stale-epoch"
    assert refusal(lambda: submit(awake, "g3", 0)) == "stale-epoch"
    assert robot.motions == 2


def test_who_has_no_lease_may_use_a_robot_whose_owner_is_gone(lab: Lab) -> None:
    lab.agent("a", PuppetRobot())
    owner, visitor = lab.orchestrator("owner"), lab.orchestrator("visitor")
    submit(owner, "g1", 5)
    owner.result("a", "g1")
    assert refusal(lambda: visitor.submit("a", "g2")) == "stale-epoch"
    owner.session.close()
    visitor.state("a", lambda s: s.status is RobotStatus.IDLE)

    def admitted() -> bool:
        try:
            visitor.submit("a", "g2")
        except RefusedError as error:
            return error.code != "stale-epoch"
        return True

    wait_until(admitted)
    assert visitor.result("a", "g2").outcome is Outcome.COMPLETED
    described = visitor.fleet.describe("a")
    assert (described.owner, described.epoch) == ("owner", 5)


def test_a_robot_refuses_an_epoch_that_jumps_and_stays_with_its_owner(
    lab: Lab, tmp_path: Path
) -> None:
    lab.agent("a", PuppetRobot(), state_folder=tmp_path / "a")
    owner, stranger = lab.orchestrator("owner"), lab.orchestrator("stranger")
    submit(owner, "g1", 5)
    owner.result("a", "g1")
    for epoch in (2**63 - 1, 2**53, 5 + 2**20 + 1):
        stranger.fleet.hold({"a": epoch})
        assert refusal(lambda: stranger.fleet.remove_prior("a")) == "epoch-jump"
    described = stranger.fleet.describe("a")
    assert (described.owner, described.epoch) == ("owner", 5)
    submit(owner, "g2", 6)
    assert owner.result("a", "g2").outcome is Outcome.COMPLETED


def test_a_robot_that_was_told_a_nonsensical_epoch_serves_again_once_it_forgot_its_owner(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fleet, state = tmp_path / "lab.toml", tmp_path / "state"
    fleet.write_text(LAB, encoding="utf-8")
    forget = ("agent", str(fleet), "--state", str(state), "--forget-owner", "--robot", "a")
    typed = Typed(monkeypatch, capfd)
    with Journal(state / "lab" / "a" / "journal") as journal:
        journal.owned("fuzzer", 2**63 - 1)
        done = typed(*forget, cwd=tmp_path)
        assert done.returncode == 1
        assert "another agent serves this robot" in done.stderr
    agent = lab.agent("a", PuppetRobot(), state_folder=state / "lab" / "a")
    client = lab.orchestrator().fleet
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
        with pytest.raises(EpochOutOfRangeError, match="--robot a --forget-owner"):
            lease_robots(repository.leases, client, "lab", client.describe_all(("a",)))
        agent.close()
        done = typed(*forget, cwd=tmp_path)
        assert done.returncode == 0
        assert done.stdout == f"a forgot fuzzer and its epoch {2**63 - 1}\n"
        lab.agent("a", PuppetRobot(), state_folder=state / "lab" / "a")
        orchestrator = lab.orchestrator("orchestrator-2")
        client = orchestrator.fleet
        with lease_robots(repository.leases, client, "lab", client.describe_all(("a",))) as leases:
            assert leases.epochs == {"a": 1}
            assert orchestrator.run("a", "g").outcome is Outcome.COMPLETED


def test_forgetting_an_owner_needs_the_name_of_a_robot_of_the_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    fleet = tmp_path / "lab.toml"
    fleet.write_text(LAB, encoding="utf-8")
    forget = ("agent", str(fleet), "--state", str(tmp_path / "state"), "--forget-owner")
    typed = Typed(monkeypatch, capfd)
    for names in ((), ("--robot", "b")):
        done = typed(*forget, *names, cwd=tmp_path)
        assert done.returncode == 2
        assert "--forget-owner needs --robot with robots of" in done.stderr
    assert not (tmp_path / "state").exists()
