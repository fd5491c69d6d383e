"""Requests for forecasts take no time from a robot that moves."""

from __future__ import annotations

import pytest
from puppet_robot import PuppetRobot

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.forecast_service import ForecastService
from nufleet.robot_agent.planner import Planner
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.messages import Refusal


def test_a_request_is_not_even_read_while_the_robot_moves() -> None:
    robot = PuppetRobot()
    planner = Planner("a", robot.spec, robot.state_names, Memory(None), None)
    running: list[str] = ["g1"]
    service = ForecastService(planner, lambda: running[0] if running else None)
    answer = service.asked(b"no message")
    assert isinstance(answer, Refusal)
    assert answer.code == "busy"
    running.clear()
    with pytest.raises(MalformedMessageError):
        service.asked(b"no message")
