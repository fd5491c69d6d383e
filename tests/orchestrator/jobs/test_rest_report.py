"""After an interrupt a person learns which robots are at rest, and is never told so by old news."""

from __future__ import annotations

import io
from collections.abc import Callable

import pytest
from rich.console import Console

from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.orchestrator.jobs.rest_report import say_who_rests
from nufleet.shared.wire.messages import RobotState, RobotStatus


class Told(RobotWatch):
    """A watch that hears one piece of news when it is waited for, and never waits longer."""

    def __init__(self, robot: str, news: RobotStatus | None, *, alive: bool = True) -> None:
        super().__init__(robot)
        self.set_alive(alive)
        self.set_state(self._said(RobotStatus.IDLE, 1))  # from before the motion
        self._news = news

    def wait_until(self, condition: Callable[[RobotWatch], bool], *, timeout_s: float) -> bool:
        if self._news is not None:
            self.set_state(self._said(self._news, 2))
        return super().wait_until(condition, timeout_s=0.0)

    def _said(self, status: RobotStatus, sequence: int) -> RobotState:
        reason = "its motors were cut" if status is RobotStatus.FAULT else ""
        return RobotState(
            robot=self.robot,
            boot_id="boot",
            sequence=sequence,
            status=status,
            goal_id="g" if status in (RobotStatus.RUNNING, RobotStatus.RESTING) else None,
            progress=0.0,
            reason=reason,
            last_goal_id=None,
            robot_time_s=0.0,
        )


def said(*watches: RobotWatch) -> str:
    console = Console(file=io.StringIO(), width=400)
    say_who_rests(console, watches)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_robots_that_report_to_be_at_rest_are_said_to_be() -> None:
    assert said(Told("a", RobotStatus.IDLE)) == "a is at rest\n"
    both = said(Told("a", RobotStatus.IDLE), Told("b", RobotStatus.STOPPED))
    assert both == "all 2 robots are at rest\n"


@pytest.mark.parametrize(
    ("robot", "waits", "doubt"),
    [
        (Told("b", None), True, "b (not heard for 0.0 s)"),
        (Told("b", RobotStatus.RESTING), True, "b (it still moves)"),
        (Told("b", RobotStatus.FAULT), False, "b (it has a fault: its motors were cut)"),
        (Told("b", None, alive=False), False, "b (its agent is gone)"),
    ],
    ids=["silent", "moving", "fault", "gone"],
)
def test_a_robot_that_may_move_is_named_with_the_reason(
    monkeypatch: pytest.MonkeyPatch, robot: Told, waits: bool, doubt: str
) -> None:
    monkeypatch.setattr(RobotWatch, "silent_s", 0.0)
    text = said(Told("a", RobotStatus.IDLE), robot)
    assert ("waiting up to 10 s for b to report to be at rest" in text) == waits
    assert f"{doubt} did not report to be at rest: look at them, or stop them" in text


def test_a_second_ctrl_c_ends_the_wait_and_the_robots_are_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def interrupted(*_: object, **__: object) -> bool:
        raise KeyboardInterrupt

    watch = Told("a", None)
    monkeypatch.setattr(watch, "wait_until", interrupted)
    console = Console(file=io.StringIO(), width=400)
    with pytest.raises(KeyboardInterrupt):
        say_who_rests(console, [watch])
    assert isinstance(console.file, io.StringIO)
    assert "a (not heard for" in console.file.getvalue()
