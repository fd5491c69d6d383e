"""The latest of one robot: what was heard, in what order, and waiting for it."""

from __future__ import annotations

import threading

import pytest
from polling import PATIENCE_S

from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.shared.wire.messages import RobotState, RobotStatus


def state(sequence: int, *, boot_id: str = "boot-1", status: str = "idle") -> RobotState:
    return RobotState(
        robot="a",
        boot_id=boot_id,
        sequence=sequence,
        status=RobotStatus(status),
        goal_id=None,
        progress=0.0,
        reason="",
        last_goal_id=None,
        robot_time_s=0.0,
    )


def test_an_older_state_of_the_same_boot_is_passed_over() -> None:
    watch = RobotWatch("a")
    assert watch.state is None
    for sequence, latest in ((3, 3), (2, 3), (3, 3), (4, 4)):
        before = watch.state
        news = watch.set_state(state(sequence, status="running" if sequence == 3 else "idle"))
        assert news == (watch.state is not before)
        assert watch.state is not None
        assert watch.state.sequence == latest


def test_another_boot_begins_to_count_anew() -> None:
    watch = RobotWatch("a")
    watch.set_state(state(100))
    watch.set_state(state(1, boot_id="boot-2"))
    assert watch.state == state(1, boot_id="boot-2")


def test_an_old_state_does_not_end_a_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    now_s = [100.0]
    monkeypatch.setattr("nufleet.orchestrator.fleet.robot_watch.time.monotonic", lambda: now_s[0])
    watch = RobotWatch("a")
    watch.set_alive(True)
    assert watch.silent_s == 0.0
    for sequence, silent_s in ((5, 0.0), (4, 1.0), (5, 2.0), (6, 0.0)):
        now_s[0] += 1.0
        watch.set_state(state(sequence))
        assert watch.silent_s == silent_s


def test_waiting_ends_when_the_condition_holds_or_the_time_is_over() -> None:
    watch = RobotWatch("a")
    assert not watch.wait_until(lambda w: w.alive, timeout_s=0.01)
    threading.Timer(0.02, watch.set_alive, [True]).start()
    assert watch.wait_until(lambda w: w.alive, timeout_s=PATIENCE_S)
    threading.Timer(0.02, watch.set_state, [state(7)]).start()
    assert watch.wait_until(
        lambda w: w.state is not None and w.state.sequence == 7, timeout_s=PATIENCE_S
    )
