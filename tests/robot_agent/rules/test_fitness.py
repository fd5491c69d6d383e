"""Whether a robot's health lets it move, and for how long."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from nufleet.robot_agent.rules.fitness import HEALTH_MAX_AGE_S, refusal_to_last, unfit
from nufleet.shared.robots.health import Health


def test_a_robot_that_reports_no_health_may_always_move() -> None:
    assert unfit(None, 1e9) is None
    assert refusal_to_last(None, 1e9) is None


def test_a_robot_may_move_while_its_last_report_is_recent_and_good() -> None:
    assert unfit(Health(), 0.0) is None
    assert unfit(Health(), HEALTH_MAX_AGE_S) is None
    assert unfit(Health(), 4.0) == "its driver has not reported its health for 4.0 s"
    assert unfit(Health(ready=False, reason="no position estimate"), 0.0) == "no position estimate"


def test_a_motion_that_outlasts_the_battery_is_refused_with_both_times() -> None:
    health = Health(battery=0.2, endurance_s=30.0)
    assert refusal_to_last(health, 30.0) is None
    refusal = refusal_to_last(health, 30.5)
    assert refusal is not None
    assert refusal.code == "battery"
    assert "takes 30.5 s" in refusal.reason
    assert "20%" in refusal.reason
    assert "lasts for 30 s" in refusal.reason
    assert refusal_to_last(Health(battery=0.2), 1e6) is None  # the driver cannot tell how long


def test_a_robot_that_is_not_ready_says_why_and_only_such_a_robot_does() -> None:
    for wrong in ({"ready": False}, {"ready": True, "reason": "locked"}):
        with pytest.raises(ValidationError, match="reason"):
            Health.model_validate(wrong)
