"""A fleet that was started is waited for, and the message says for how long it was."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from nufleet.orchestrator.fleet.connection import START_TIMEOUT_S, wait_for_robots
from nufleet.shared.errors import RobotLostError


class Absent:
    """A fleet whose robots never appear."""

    def __init__(self) -> None:
        self.waited_s = 0.0

    def wait_for(self, robots: tuple[str, ...], *, timeout_s: float) -> None:
        self.waited_s += timeout_s
        raise RobotLostError(f"robot {robots[0]} did not appear within {timeout_s:g} s")

    def watch(self, robot: str) -> Any:
        return SimpleNamespace(alive=robot == "early")


def test_robots_that_do_not_start_are_named_with_the_whole_time_that_was_waited() -> None:
    fleet: Any = Absent()
    started: Any = SimpleNamespace(dead=list)
    file: Any = SimpleNamespace(robots={"early": None, "late": None})
    with pytest.raises(RobotLostError, match="robots late did not start within 60 s"):
        wait_for_robots(fleet, started, file)
    assert fleet.waited_s == START_TIMEOUT_S == 60.0
