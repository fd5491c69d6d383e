"""The time axis of a study."""

from __future__ import annotations

from nufleet.orchestrator.viewer.clock import ViewerClock


class Wall:
    def __init__(self) -> None:
        self.now_s = 100.0

    def __call__(self) -> float:
        return self.now_s


def test_it_begins_at_zero_and_runs_with_the_wall_clock() -> None:
    wall = Wall()
    clock = ViewerClock(wall)
    wall.now_s += 2.5
    assert clock.now_s() == 2.5


def test_it_jumps_ahead_by_what_simulated_robots_moved_faster_than_the_wall_clock() -> None:
    wall = Wall()
    clock = ViewerClock(wall)
    wall.now_s += 1.0
    clock.advance_to(60.0)
    assert clock.now_s() == 60.0
    wall.now_s += 1.0
    assert clock.now_s() == 61.0


def test_it_never_goes_back() -> None:
    wall = Wall()
    clock = ViewerClock(wall)
    wall.now_s += 10.0
    clock.advance_to(5.0)
    assert clock.now_s() == 10.0
