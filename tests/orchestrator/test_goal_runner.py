"""Results are asked for again, for they are kept until they are acknowledged."""

from __future__ import annotations

import math
from typing import Any, cast

import pytest

from orchestrator import goal_runner
from orchestrator.fleet import Fleet
from orchestrator.goal_runner import GoalRunner
from shared.errors import NoReplyError


class HeardRobot:
    robot, alive, silent_s = "near", True, 0.0

    def wait_until(self, condition: Any, timeout_s: float) -> bool:
        return bool(condition(self))


class ForgetfulNetwork:
    """Loses some questions, and each takes longer than the patience with a robot that is gone."""

    def __init__(self, loses: int) -> None:
        self.loses, self.asked = loses, 0

    def watch(self, robot: str) -> HeardRobot:
        return HeardRobot()

    def result(self, robot: str, goal_id: str) -> str:
        self.asked += 1
        if self.asked <= self.loses:
            raise NoReplyError(f"robot {robot} did not answer about goal {goal_id}")
        return "the result"


@pytest.fixture(autouse=True)
def no_patience(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(goal_runner, "RETURN_PATIENCE_S", -math.inf)


def test_a_question_that_is_lost_is_asked_again() -> None:
    network = ForgetfulNetwork(loses=1)
    assert cast(object, GoalRunner(cast(Fleet, network)).result("near", "g")) == "the result"
    assert network.asked == 2


def test_two_in_a_row_are_an_error_that_names_robot_and_goal() -> None:
    network = ForgetfulNetwork(loses=9)
    with pytest.raises(NoReplyError, match=r"near .* goal g"):
        GoalRunner(cast(Fleet, network)).result("near", "g")
    assert network.asked == 2
