"""Decisions whose journal's disk is slow, full or altered."""

from __future__ import annotations

import errno
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from agent_lives import EXCITATION, result_of
from puppet_robot import puppet_spec

from nufleet.robot_agent import planner as planner_module
from nufleet.robot_agent.decisions import Assignment, Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.journal import LOG, Journal
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared import private_files
from nufleet.shared.errors import RefusedError
from nufleet.shared.wire.messages import (
    GoalAccepted,
    GoalRequest,
    GoalResult,
    Outcome,
    Refusal,
    RobotStatus,
)

SMOKE = StopOrder("alice", "smoke")


@contextmanager
def agent_on(folder: Path) -> Iterator[Decisions]:
    with Journal(folder) as journal:
        planner = Planner("r", puppet_spec(), (), Memory(None), None)
        decisions = Decisions("boot", planner, journal, threading.Event())
        decisions.owner_appeared("o")
        yield decisions


def take(decisions: Decisions, goal_id: str) -> tuple[GoalAccepted | Refusal, Assignment | None]:
    return decisions.take(GoalRequest(goal_id=goal_id, owner="o", motion=EXCITATION))


def begun(decisions: Decisions, goal_id: str) -> Assignment:
    motion = take(decisions, goal_id)[1]
    assert motion is not None
    return motion


def refused(decisions: Decisions, goal_id: str) -> str:
    answer, motion = take(decisions, goal_id)
    assert isinstance(answer, Refusal)
    assert motion is None
    return answer.code


def full(*_: object) -> None:
    raise OSError(errno.ENOSPC, "No space left on device")


def before_each_write(monkeypatch: pytest.MonkeyPatch, act: Callable[[], None]) -> None:
    write = private_files.write_all

    def acting(descriptor: int, data: bytes) -> None:
        act()
        write(descriptor, data)

    monkeypatch.setattr(private_files, "write_all", acting)


def test_a_goal_that_cannot_be_stored_is_refused_and_forgotten(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        with monkeypatch.context() as disk:
            disk.setattr(private_files, "write_all", full)
            answer, motion = take(decisions, "a")
            assert motion is None
            assert isinstance(answer, Refusal)
            assert answer.code == "journal"
            assert "No space left on device; free or repair the disk" in answer.reason
            assert decisions.state().status is RobotStatus.IDLE
            unknown = decisions.result("a")
            assert isinstance(unknown, Refusal)
            assert unknown.code == "unknown-goal"
        assert begun(decisions, "a").switch.order is None


def test_the_robot_is_free_again_though_the_end_of_its_goal_could_not_be_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    with agent_on(tmp_path) as decisions:
        result = result_of(begun(decisions, "a"))
        with monkeypatch.context() as disk:
            disk.setattr(private_files, "write_all", full)
            decisions.ended(result, None)
            assert "the end of a could not be stored" in caplog.text
            assert decisions.result("a") == result
            assert refused(decisions, "b") == "journal"
        begun(decisions, "b")
    with agent_on(tmp_path) as decisions:
        for goal_id in ("a", "b"):
            lost = decisions.result(goal_id)
            assert isinstance(lost, GoalResult)
            assert lost.outcome is Outcome.LOST


def test_a_stopped_robot_is_seen_at_rest_while_the_disk_is_stuck_with_its_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        motion = begun(decisions, "a")
        decisions.stop(SMOKE)
        result = result_of(motion)
        assert decisions.state().status is RobotStatus.RESTING
        seen: list[tuple[RobotStatus, str | None]] = []

        def look() -> None:
            state = decisions.state()
            seen.append((state.status, state.goal_id))

        decisions.at_rest()
        with monkeypatch.context() as disk:
            before_each_write(disk, look)
            decisions.ended(result, None)
        assert set(seen) == {(RobotStatus.STOPPED, "a")}
        assert decisions.state().goal_id is None


def test_a_stop_halts_at_once_while_the_disk_is_stuck_with_a_goal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        halted: list[bool] = []

        def stop() -> None:
            stopping = threading.Thread(target=decisions.stop, args=(SMOKE,))
            stopping.start()
            stopping.join(5.0)
            halted.append(not stopping.is_alive())

        with monkeypatch.context() as disk:
            before_each_write(disk, stop)
            motion = begun(decisions, "a")
        assert halted == [True]
        assert motion.switch.order == (Outcome.ABORTED, "stopped by alice: smoke")


def test_a_stop_that_comes_while_a_release_is_stored_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        decisions.stop(SMOKE)
        decisions.store_stop()
        with monkeypatch.context() as disk:
            before_each_write(disk, lambda: decisions.stop(StopOrder("bob", "fire")))
            refusal = decisions.release("carol")
        assert refusal is not None
        assert refusal.code == "stopped"
        assert refused(decisions, "a") == "stopped"
        decisions.store_stop()  # as the handler of that stop does next
    with agent_on(tmp_path) as decisions:
        assert refused(decisions, "a") == "stopped"
        assert decisions.release("carol") is None
        begun(decisions, "a")


def test_a_copy_of_the_stop_that_a_release_ends_keeps_nobody_stopped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smoke = StopOrder("alice", "smoke", "1")
    with agent_on(tmp_path) as decisions:
        decisions.stop(smoke)
        decisions.store_stop()
        with monkeypatch.context() as disk:
            before_each_write(disk, lambda: decisions.stop(smoke))
            assert decisions.release("carol") is None
        decisions.store_stop()  # as the handler of that copy does next
        assert not decisions.stop(smoke)
        begun(decisions, "a")
    with agent_on(tmp_path) as decisions:
        assert not decisions.stopped


def test_a_copy_that_cuts_the_motors_while_a_release_is_stored_ends_the_release(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    smoke = StopOrder("alice", "smoke", "1")
    with agent_on(tmp_path) as decisions:
        decisions.stop(smoke, kill=True)
        decisions.store_stop()
        with monkeypatch.context() as disk:
            before_each_write(disk, lambda: decisions.stop(smoke, kill=True))
            refusal = decisions.release("carol")
        assert refusal is not None
        assert refusal.code == "stopped"
        assert decisions.stopped


def test_a_release_that_cannot_be_stored_releases_nobody(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        decisions.stop(SMOKE)
        decisions.store_stop()
        with monkeypatch.context() as disk:
            disk.setattr(private_files, "write_all", full)
            with pytest.raises(JournalError, match="No space left"):
                decisions.release("carol")
        assert refused(decisions, "a") == "stopped"
        assert decisions.release("carol") is None


def test_acknowledgements_that_cannot_be_stored_keep_the_results_and_refuse_no_goal(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        result = result_of(begun(decisions, "a"))
        decisions.ended(result, None)
        again = GoalRequest(goal_id="a", owner="o", motion=EXCITATION, acknowledges=("a",))
        with monkeypatch.context() as disk:
            disk.setattr(private_files, "write_all", full)
            with pytest.raises(JournalError):
                decisions.acknowledge(["a"], Commander("o"))
            assert isinstance(decisions.take(again)[0], GoalAccepted)
        assert decisions.result("a") == result


def test_a_damaged_journal_leaves_the_robot_stopped_with_the_reason(tmp_path: Path) -> None:
    with agent_on(tmp_path) as decisions:
        decisions.ended(result_of(begun(decisions, "a")), None)
    data = bytearray((tmp_path / LOG).read_bytes())
    data[len(data) // 2] ^= 1
    (tmp_path / LOG).write_bytes(data)
    with agent_on(tmp_path) as decisions:
        state = decisions.state()
        assert state.status is RobotStatus.STOPPED
        assert "was altered" in state.reason
        assert "inspect the robot, then release it" in state.reason
        assert decisions.release("alice") is None
        assert decisions.state().status is RobotStatus.IDLE


def test_a_goal_that_was_lost_is_said_to_be_at_once(tmp_path: Path) -> None:
    with agent_on(tmp_path) as decisions:
        plan = begun(decisions, "a").plan
    with agent_on(tmp_path) as decisions:
        state = decisions.state()
        assert (state.goal_id, state.last_goal_id) == (None, "a")
        assert state.reason == "the previous agent process ended during a"
        result = decisions.result("a")
        assert isinstance(result, GoalResult)
        assert (result.outcome, result.plan) == (Outcome.LOST, plan)
        assert result.reason.startswith("lost: the agent process boot ended during it")


def test_a_goal_that_was_cancelled_before_it_came_is_refused_over_restarts(tmp_path: Path) -> None:
    with agent_on(tmp_path) as decisions:
        assert decisions.cancel("a", Commander("o")) is None
        assert decisions.state().last_goal_id is None
    for _ in range(2):
        with agent_on(tmp_path) as decisions:
            assert refused(decisions, "a") == "cancelled"
            assert decisions.cancel("a", Commander("o")) is None
            result = decisions.result("a")
            assert isinstance(result, Refusal)
            assert result.code == "result-gone"
            assert decisions.state().status is RobotStatus.IDLE
    with agent_on(tmp_path) as decisions:
        begun(decisions, "b")


def test_a_cancel_that_cannot_be_stored_is_confirmed_by_none_that_follows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        with monkeypatch.context() as disk:
            disk.setattr(private_files, "write_all", full)
            for _ in range(2):
                with pytest.raises(JournalError, match="No space left"):
                    decisions.cancel("a", Commander("o"))
            assert refused(decisions, "a") == "cancelled"  # of this process it is not a danger
        assert decisions.cancel("a", Commander("o")) is None
    with agent_on(tmp_path) as decisions:
        assert refused(decisions, "a") == "cancelled"


def test_a_cancel_that_comes_while_its_goal_is_stored_waits_for_what_becomes_of_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with agent_on(tmp_path) as decisions:
        answers: list[Refusal | None] = []
        cancelling = threading.Thread(
            target=lambda: answers.append(decisions.cancel("a", Commander("o")))
        )

        def full_while_it_is_cancelled() -> None:
            cancelling.start()
            cancelling.join(0.05)
            full()

        with monkeypatch.context() as disk:
            before_each_write(disk, full_while_it_is_cancelled)
            assert refused(decisions, "a") == "journal"
        cancelling.join(5.0)
        assert answers == [None]
        assert refused(decisions, "a") == "cancelled"


def test_a_goal_that_is_known_keeps_its_plan_whatever_the_robot_learns(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise RefusedError("amplitude", "not any more", "r")

    with agent_on(tmp_path) as decisions:
        motion = begun(decisions, "a")
        monkeypatch.setattr(planner_module, "plan_excitation", refuse)
        for _ in range(2):  # while it runs, and after its end
            answer, again = take(decisions, "a")
            assert isinstance(answer, GoalAccepted)
            assert (answer.plan, again) == (motion.plan, None)
            if decisions.state().goal_id == "a":
                decisions.ended(result_of(motion), None)
    with agent_on(tmp_path) as decisions:
        answer, _ = take(decisions, "a")
        assert isinstance(answer, GoalAccepted)
        assert answer.plan == motion.plan
