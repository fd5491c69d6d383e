"""Stops are taken at once and answered when they are stored, however slow or full the disk is."""

from __future__ import annotations

import errno
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from unittest.mock import Mock

import pytest
from agent_lives import EXCITATION
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.commands import Commands
from nufleet.robot_agent.decisions import Decisions
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.planner import Planner
from nufleet.robot_agent.stop_service import StopService
from nufleet.shared import private_files
from nufleet.shared.errors import MalformedMessageError, RobotError
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.frame import PROTOCOL_VERSION, framed
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import (
    Done,
    GoalRequest,
    Outcome,
    Refusal,
    RobotStatus,
    StopRequest,
)

STOP = encode(StopRequest(sender="alice", reason="smoke"))


@pytest.fixture
def journal(tmp_path: Path) -> Iterator[Journal]:
    with Journal(tmp_path / "journal") as journal:
        yield journal


@pytest.fixture
def decisions(journal: Journal) -> Decisions:
    planner = Planner("r", puppet_spec(), (), Memory(None), None)
    return Decisions("boot", planner, journal, threading.Event())


@pytest.fixture
def robot() -> PuppetRobot:
    robot = PuppetRobot()
    robot.on_kill = Mock()
    return robot


@pytest.fixture
def stops(decisions: Decisions, robot: PuppetRobot) -> Iterator[StopService]:
    with ThreadPoolExecutor(1) as writer:
        keys, commands = FleetKeys("lab"), Commands(None)
        stops = StopService("r", decisions, keys, commands, robot.kill, writer=writer)
        yield stops
        stops.close()


def stored_stop(tmp_path: Path, journal: Journal) -> str | None:
    journal.close()
    with Journal(tmp_path / "journal") as reopened:
        stop = reopened.remembrance.stop
        return None if stop is None else f"{stop.sender}: {stop.reason}"


def test_what_a_key_contains_does_not_reach_the_terminal(
    stops: StopService, caplog: pytest.LogCaptureFixture
) -> None:
    stops.heard("nufleet/lab/by/\x1b[31m\nrobot r: all is well/stop", b"no message")
    assert "malformed stop on" in caplog.text
    assert "\x1b" not in caplog.text
    assert "\nrobot r" not in caplog.text


def test_a_stop_is_answered_when_it_is_stored(
    stops: StopService, tmp_path: Path, journal: Journal
) -> None:
    assert stops.asked("alice", STOP).result(PATIENCE_S) == Done()
    assert stored_stop(tmp_path, journal) == "alice: smoke"


def test_a_stop_on_the_fleets_key_is_stored_too(
    stops: StopService, tmp_path: Path, journal: Journal
) -> None:
    stops.heard("nufleet/lab/by/alice/stop", STOP)
    stops.close()
    assert stored_stop(tmp_path, journal) == "alice: smoke"


def test_a_thousand_stops_halt_at_once_while_the_disk_is_stuck(
    stops: StopService, decisions: Decisions, monkeypatch: pytest.MonkeyPatch
) -> None:
    decisions.owner_appeared("o")
    goal = GoalRequest(goal_id="a", owner="o", motion=EXCITATION)
    motion = decisions.take(goal)[1]
    assert motion is not None
    stuck, goes_on = threading.Event(), threading.Event()
    write = private_files.write_all

    def write_slowly(descriptor: int, data: bytes) -> None:
        stuck.set()
        assert goes_on.wait(PATIENCE_S)
        write(descriptor, data)

    monkeypatch.setattr(private_files, "write_all", write_slowly)
    first = stops.asked("alice", STOP)
    assert motion.switch.order == (Outcome.ABORTED, "stopped by alice: smoke")
    assert stuck.wait(PATIENCE_S)
    answers = {stops.asked("alice", STOP) for _ in range(1000)}
    assert len(answers) == 1, "all that wait together wait for one write"
    assert not first.done()
    goes_on.set()
    assert {answer.result(PATIENCE_S) for answer in (first, *answers)} == {Done()}


def test_a_stop_that_cannot_be_stored_halts_and_says_so_and_the_next_one_tries_again(
    stops: StopService,
    tmp_path: Path,
    journal: Journal,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as disk:
        disk.setattr(private_files, "write_all", full)
        answer = stops.asked("alice", STOP).result(PATIENCE_S)
        assert isinstance(answer, Refusal)
        assert answer.code == "journal"
        assert "it was halted, but the stop will not outlast its agent" in answer.reason
        assert "No space left" in answer.reason
    assert stops.asked("alice", STOP).result(PATIENCE_S) == Done()
    assert stored_stop(tmp_path, journal) == "alice: smoke"


def test_a_garbled_stop_is_a_stop(stops: StopService, tmp_path: Path, journal: Journal) -> None:
    with pytest.raises(MalformedMessageError):
        stops.asked("alice", b"stop!!")
    stops.close()
    assert stored_stop(tmp_path, journal) == "alice: a malformed stop: not a nufleet message"


def test_who_asks_an_agent_that_ends_is_told_so(stops: StopService, decisions: Decisions) -> None:
    stops.close()
    answer = stops.asked("alice", STOP).result(PATIENCE_S)
    assert isinstance(answer, Refusal)
    assert answer.code == "shutting-down"
    wait_until(lambda: not [t for t in threading.enumerate() if t.name.startswith("r-stops")])


KILL = encode(StopRequest(sender="alice", reason="smoke", kill=True))


def test_a_kill_stops_and_cuts_the_motors_and_only_a_reconnection_undoes_it(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    assert stops.asked("alice", KILL).result(PATIENCE_S) == Done()
    assert isinstance(robot.on_kill, Mock)
    robot.on_kill.assert_called_once_with()
    assert decisions.fault == "its motors were cut by alice: smoke"
    assert decisions.release("alice") is None
    decisions.owner_appeared("o")
    refused, _ = decisions.take(GoalRequest(goal_id="a", owner="o", motion=EXCITATION))
    assert isinstance(refused, Refusal)
    assert refused.code == "fault"


def test_a_late_copy_of_a_kill_cuts_no_motors_again_but_another_kill_does(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    assert isinstance(robot.on_kill, Mock)
    assert stops.asked("alice", KILL).result(PATIENCE_S) == Done()
    stops.heard("nufleet/lab/robot/r/by/alice/stop", KILL)
    assert stops.asked("alice", KILL).result(PATIENCE_S) == Done()
    assert robot.on_kill.call_count == 1
    assert decisions.release("alice") is None
    another = encode(StopRequest(sender="alice", reason="smoke", kill=True))
    assert stops.asked("alice", another).result(PATIENCE_S) == Done()
    assert robot.on_kill.call_count == 2


def test_a_kill_that_failed_is_tried_again_by_its_copy(
    stops: StopService, robot: PuppetRobot
) -> None:
    robot.on_kill = Mock(side_effect=[RobotError("no radio"), None])
    failed = stops.asked("alice", KILL).result(PATIENCE_S)
    assert isinstance(failed, Refusal)
    assert failed.code == "not-killed"
    assert stops.asked("alice", KILL).result(PATIENCE_S) == Done()


def test_a_copy_that_comes_after_the_release_of_its_stop_neither_stops_nor_cuts_motors(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    for order in (STOP, KILL):
        assert stops.asked("alice", order).result(PATIENCE_S) == Done()
        assert decisions.release("alice") is None
        answer = stops.asked("alice", order).result(PATIENCE_S)
        assert isinstance(answer, Refusal)
        assert answer.code == "released"
        assert answer.reason == "it obeyed this stop, and was released since"
        stops.heard("nufleet/lab/by/alice/stop", order)
        assert not decisions.stopped
    assert isinstance(robot.on_kill, Mock)
    robot.on_kill.assert_called_once_with()


def test_a_stop_that_names_no_order_is_always_obeyed(
    stops: StopService, decisions: Decisions
) -> None:
    stop = framed(
        b'{"protocol": %d, "type": "StopRequest", "arrays": []}' % PROTOCOL_VERSION,
        b'{"sender": "alice", "reason": "smoke"}',
    )
    for _ in range(2):
        assert stops.asked("alice", stop).result(PATIENCE_S) == Done()
        assert decisions.stopped
        assert decisions.release("alice") is None


def test_a_motion_is_halted_before_its_motors_are_cut(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    decisions.owner_appeared("o")
    _, motion = decisions.take(GoalRequest(goal_id="a", owner="o", motion=EXCITATION))
    assert motion is not None
    halted: list[bool] = []
    robot.on_kill = lambda: halted.append(motion.switch.order is not None)
    assert stops.asked("alice", KILL).result(PATIENCE_S) == Done()
    assert halted == [True]


def test_a_robot_without_a_switch_is_stopped_and_the_sender_learns_that_it_was_not_killed(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    robot.on_kill = None
    answer = stops.asked("alice", KILL).result(PATIENCE_S)
    assert isinstance(answer, Refusal)
    assert answer.code == "not-killed"
    assert "no way of cutting its motors" in answer.reason
    assert decisions.fault is None
    assert decisions.state().status is RobotStatus.STOPPED


def test_a_driver_that_hangs_in_its_kill_holds_up_no_stop(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    goes_on = threading.Event()
    robot.on_kill = Mock(side_effect=lambda: goes_on.wait(PATIENCE_S))
    killing = [stops.asked("alice", KILL) for _ in range(3)]
    assert stops.asked("bob", STOP).result(PATIENCE_S) == Done()
    assert not any(answer.done() for answer in killing)
    goes_on.set()
    assert [answer.result(PATIENCE_S) for answer in killing] == [Done()] * 3
    robot.on_kill.assert_called_once_with()  # by one thread, however often it is asked


def test_a_kill_whose_stop_cannot_be_stored_is_not_confirmed(
    stops: StopService,
    decisions: Decisions,
    journal: Journal,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def full(order: object) -> None:
        raise JournalError("no space left on the device")

    monkeypatch.setattr(journal, "stopped", full)
    answer = stops.asked("alice", KILL).result(PATIENCE_S)
    assert isinstance(answer, Refusal)
    assert answer.code == "journal"
    assert decisions.fault == "its motors were cut by alice: smoke"


def test_nobody_releases_a_robot_whose_motors_are_being_cut(
    stops: StopService, decisions: Decisions, robot: PuppetRobot
) -> None:
    refused: list[Refusal | None] = []
    robot.on_kill = lambda: refused.append(decisions.release("bob"))
    assert stops.asked("alice", KILL).result(PATIENCE_S) == Done()
    assert refused == [
        Refusal(code="busy", reason="its motors are being cut; release it in a moment")
    ]
    assert decisions.release("bob") is None
