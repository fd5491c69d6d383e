"""Orchestrators that want the same robots, over a real router: by one repository and by two."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest
from fleet_lab import SLOW, Lab, Orchestrator, refusal, submitted
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.conduct import leases as held_leases
from nufleet.orchestrator.conduct.leases import HeldLeases, lease_robots
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import LeaseHeldError
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.errors import RobotOwnedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import Description, Outcome

TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)


def lease(
    repository: Repository,
    orchestrator: Orchestrator,
    described: Mapping[str, Description] | None = None,
    **options: bool,
) -> HeldLeases:
    """Lease the robot, by an earlier description of it or by its present one."""
    fleet = orchestrator.fleet
    described = described or fleet.describe_all(("a",))
    return lease_robots(repository.leases, fleet, "lab", described, **options)


def test_of_two_that_want_a_robot_at_once_one_has_it_and_the_other_is_told_who(
    lab: Lab, tmp_path: Path
) -> None:
    robot = PuppetRobot()
    lab.agent("a", robot)
    rivals = [lab.orchestrator(name) for name in ("first", "second")]
    together, done = (threading.Barrier(2, timeout=PATIENCE_S) for _ in range(2))

    def work(rival: Orchestrator) -> str:
        with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
            together.wait()
            try:
                leases = lease(repository, rival)
            except LeaseHeldError as held:
                done.wait()
                return held.owner
            with leases:
                done.wait()
                goal_id = f"goal-of-{rival.fleet.orchestrator_id}"
                assert GoalRunner(rival.fleet).run("a", goal_id, TEST).outcome is Outcome.COMPLETED
            return "had it"

    with ThreadPoolExecutor(2) as pool:
        found = dict(zip(("first", "second"), pool.map(work, rivals), strict=True))
    winner = next(name for name, came in found.items() if came == "had it")
    loser = "second" if winner == "first" else "first"
    assert found[loser] == winner
    assert robot.motions == 1


def test_who_keeps_another_repository_is_told_who_commands_a_robot_until_that_one_is_gone(
    lab: Lab, tmp_path: Path
) -> None:
    lab.agent("a", PuppetRobot())
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    with (
        open_repository(f"{tmp_path}/one.sqlite") as one,
        open_repository(f"{tmp_path}/other.sqlite") as other,
    ):
        for number in range(3):  # so that the first one's epochs are ahead
            with lease(one, first):
                GoalRunner(first.fleet).run("a", f"g{number}", TEST)
        with pytest.raises(RobotOwnedError, match=r"commanded by first \(epoch 3\).*--repository"):
            lease(other, second)
        first.session.close()
        wait_until(lambda: not second.fleet.is_alive("first"))
        with lease(other, second) as leases:
            assert leases.epochs == {"a": 4}
            assert GoalRunner(second.fleet).run("a", "g", TEST).outcome is Outcome.COMPLETED
        assert second.fleet.describe("a").owner == "second"


@pytest.mark.parametrize("ahead", [0, 1, 3])
def test_a_living_owner_is_left_its_robot_however_far_the_epochs_of_another_repository_are(
    lab: Lab, tmp_path: Path, ahead: int
) -> None:
    """Epochs of two repositories cannot be compared, even if they are equal."""
    lab.agent("a", PuppetRobot())
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    with (
        open_repository(f"{tmp_path}/one.sqlite") as one,
        open_repository(f"{tmp_path}/other.sqlite") as other,
    ):
        for _ in range(ahead):  # it leased the robot earlier, and ended before it moved
            with lease(other, second):
                pass
        with lease(one, first):
            GoalRunner(first.fleet).run("a", "g", TEST)
            with pytest.raises(RobotOwnedError, match=r"commanded by first \(epoch 1\)"):
                lease(other, second)
            GoalRunner(first.fleet).run("a", "h", TEST)
        assert second.fleet.describe("a").owner == "first"


@pytest.mark.parametrize("ahead", [0, 1])
def test_a_description_from_before_another_took_the_robot_gives_it_no_second_owner(
    lab: Lab, tmp_path: Path, ahead: int
) -> None:
    """One of the two is obeyed and the other refused, whichever has the higher epoch."""
    lab.agent("a", PuppetRobot())
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    with (
        open_repository(f"{tmp_path}/one.sqlite") as one,
        open_repository(f"{tmp_path}/other.sqlite") as other,
    ):
        for _ in range(ahead):
            with lease(other, second):
                pass
        before = second.fleet.describe_all(("a",))
        with lease(one, first):
            GoalRunner(first.fleet).run("a", "g", TEST)
            with lease(other, second, before):
                owner, other_one = (second, first) if ahead else (first, second)
                assert GoalRunner(owner.fleet).run("a", "h", TEST).outcome is Outcome.COMPLETED
                epoch = other_one.fleet.epoch("a")
                late = other_one.request("i").model_copy(update={"epoch": epoch})
                assert refusal(lambda: other_one.fleet.submit("a", late)) == "stale-epoch"
        assert first.fleet.describe("a").owner == owner.fleet.orchestrator_id


def test_who_released_a_robot_may_live_on_when_another_of_its_repository_takes_it(
    lab: Lab, tmp_path: Path
) -> None:
    lab.agent("a", PuppetRobot())
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
        with lease(repository, first):
            GoalRunner(first.fleet).run("a", "g", TEST)
        with lease(repository, second) as leases:
            assert leases.epochs == {"a": 2}
            GoalRunner(second.fleet).run("a", "h", TEST)


def test_an_owner_whose_lease_ran_out_by_a_clock_that_was_set_forward_is_left_its_robot(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lab.agent("a", PuppetRobot())
    first, second = lab.orchestrator("first"), lab.orchestrator("second")
    right = Database.now_s
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
        lease(repository, first)  # never entered: it is about to renew it
        monkeypatch.setattr(Database, "now_s", lambda *asked: right(*asked) + 3600.0)
        assert not repository.leases.held("lab")
        with pytest.raises(RobotOwnedError, match=r"owned by first \(epoch 1\), which is alive"):
            lease(repository, second)
        first.session.close()
        wait_until(lambda: not second.fleet.is_alive("first"))
        with lease(repository, second) as leases:
            assert leases.epochs == {"a": 2}


def test_who_only_watches_needs_no_lease(lab: Lab, tmp_path: Path) -> None:
    lab.agent("a", PuppetRobot(), realtime=1.0)
    owner, watcher = lab.orchestrator("owner"), lab.orchestrator("watcher")
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository, lease(repository, owner):
        motion = TEST.model_copy(update=SLOW)
        with ThreadPoolExecutor(1) as pool:
            runner = GoalRunner(owner.fleet)
            running = pool.submit(runner.run, "a", "g", motion)
            state = watcher.state("a", lambda s: s.goal_id == "g" and s.progress > 0.0)
            assert state.goal_id == "g"
            assert watcher.fleet.describe("a").owner == "owner"
            assert [who for who, *_ in repository.leases.held("lab").values()] == ["owner"]
            runner.interrupt()
            assert running.result().outcome is Outcome.CANCELLED
        assert watcher.fleet.result("a", "g").outcome is Outcome.CANCELLED


def test_a_robot_whose_owner_falls_silent_rests_and_is_taken_over_within_the_lease(
    lab: Lab, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(held_leases, "TERM_S", 1.0)
    robot = PuppetRobot()
    lab.agent("a", robot, realtime=1.0)
    silent, heir = lab.orchestrator("silent"), lab.orchestrator("heir")
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
        lease(repository, silent)  # never entered, hence never renewed
        request = silent.request("g", **SLOW)
        epoch = silent.fleet.epoch("a")
        submitted(silent.fleet, "a", request.model_copy(update={"epoch": epoch}))
        wait_until(lambda: not robot.at_rest)
        silent.session.close()
        with lease(repository, heir, patient=True) as leases:
            assert leases.epochs["a"] == epoch + 1
            wait_until(lambda: robot.at_rest)
            quick = heir.request("h")
            assert isinstance(quick.motion, Excitation)
            assert GoalRunner(heir.fleet).run("a", "h", quick.motion).outcome is Outcome.COMPLETED
