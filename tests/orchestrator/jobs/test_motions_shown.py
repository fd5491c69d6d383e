"""What a person at a terminal sees while robots move."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from nufleet.orchestrator.fleet.robot_watch import RobotWatch
from nufleet.orchestrator.jobs import terminal
from nufleet.orchestrator.jobs.motions_shown import ROWS_MAX, MotionBars, motions_shown
from nufleet.shared.wire.messages import RobotState, RobotStatus


class Robot:
    """A robot that was heard at times of the test's own clock."""

    def __init__(self, name: str) -> None:
        self.watch = RobotWatch(name)
        self.watch.set_alive(True)
        self._sequence = 0

    def heard(self, at_s: float, progress: float, goal_id: str | None = "g1") -> None:
        self._sequence += 1
        state = RobotState(
            robot=self.watch.robot,
            boot_id="boot-1",
            sequence=self._sequence,
            status=RobotStatus.RUNNING if goal_id else RobotStatus.IDLE,
            goal_id=goal_id,
            progress=progress,
            reason="",
            last_goal_id=None,
            robot_time_s=0.0,
        )
        self.watch.set_state(state)
        self.watch._heard_s = at_s


def shown(bars: MotionBars) -> list[str]:
    console = Console(file=io.StringIO(), width=80, record=True)
    console.print(bars)
    lines = [line.replace("━", "").split() for line in console.export_text().splitlines()]
    return [" ".join(words) for words in lines if words]


def test_each_motion_has_a_bar_with_the_time_that_it_still_takes(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    now_s = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now_s[0])
    drone, idle = Robot("drone"), Robot("idle")
    bars = MotionBars([drone.watch, idle.watch], lambda: now_s[0])
    idle.heard(100.0, 0.0, goal_id=None)
    drone.heard(100.0, 0.1)
    assert shown(bars) == ["drone 10%"]
    now_s[0] = 104.0
    drone.heard(103.0, 0.4)  # a tenth in each second, and silent for one
    assert shown(bars) == ["drone 40% 5 s left"]
    drone.heard(104.0, 0.0, goal_id="g2")
    assert shown(bars) == ["drone 0%"]
    drone.heard(104.0, 0.0, goal_id=None)
    assert shown(bars) == []


def test_a_large_fleet_leaves_room_for_other_lines() -> None:
    robots = [Robot(f"r{k}") for k in range(ROWS_MAX + 3)]
    for robot in robots:
        robot.heard(0.0, 0.5)
    lines = shown(MotionBars([robot.watch for robot in robots]))
    assert len(lines) == ROWS_MAX + 1
    assert lines[-1] == "and 3 more"


@pytest.mark.parametrize("is_terminal", [True, False])
def test_bars_are_drawn_on_a_terminal_alone(is_terminal: bool) -> None:
    drone = Robot("drone")
    drone.heard(0.0, 0.5)
    console = Console(file=io.StringIO(), force_terminal=is_terminal, width=80)
    with motions_shown(console, [drone.watch]):
        console.print("iteration 1")
    assert isinstance(console.file, io.StringIO)
    said = console.file.getvalue()
    assert ("50%" in said) == is_terminal
    assert "iteration" in said


def test_one_terminal_is_written_by_one_console(monkeypatch: pytest.MonkeyPatch) -> None:
    progress = Console(stderr=True, force_terminal=True)
    out = Console(force_terminal=True)
    monkeypatch.setattr(terminal, "stdout_console", lambda: out)
    assert terminal.results_console(progress, as_json=False) is progress
    monkeypatch.setattr(out, "_force_terminal", False)
    assert terminal.results_console(progress, as_json=False) is out
