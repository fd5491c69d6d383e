"""A fleet that was started is waited for as long as its robots keep appearing."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from nufleet.orchestrator.fleet.connection import START_TIMEOUT_S, wait_for_robots
from nufleet.shared.errors import RobotLostError


class Appearing:
    """A fleet each of whose robots appears at a time, in s, of a clock that only waiting moves."""

    def __init__(self, at_s: dict[str, float]) -> None:
        self.at_s = at_s
        self.waited_s = 0.0

    def wait_for(self, robots: tuple[str, ...], *, timeout_s: float) -> None:
        self.waited_s += timeout_s
        if not all(self.watch(robot).alive for robot in robots):
            raise RobotLostError(f"robot {robots[0]} did not appear within {timeout_s:g} s")

    def watch(self, robot: str) -> Any:
        return SimpleNamespace(alive=self.at_s[robot] <= self.waited_s)


def wait(fleet: Any) -> list[int]:
    """Wait for a fleet; return how many robots were there, each time that this was told."""
    started: Any = SimpleNamespace(dead=list)
    file: Any = SimpleNamespace(robots=dict.fromkeys(fleet.at_s))
    there: list[int] = []
    wait_for_robots(fleet, started, file, lambda count, of: there.append(count))
    return there


def test_a_large_fleet_may_take_long_as_long_as_robots_keep_appearing() -> None:
    fleet = Appearing({f"r{number}": 50.0 * number for number in range(10)})
    there = wait(fleet)
    assert fleet.waited_s == 450.0
    assert there == sorted(there)
    assert set(there) == set(range(11))


def test_robots_that_do_not_start_are_named_but_not_hundreds_of_them() -> None:
    never = {f"late-{number}": float("inf") for number in range(300)}
    fleet = Appearing({"early": 20.0, **never})
    with pytest.raises(RobotLostError) as lost:
        wait(fleet)
    assert fleet.waited_s == 20.0 + START_TIMEOUT_S
    said = str(lost.value)
    assert "late-0, " in said
    assert "and 292 more did not start: for 60 s no further robot appeared" in said
