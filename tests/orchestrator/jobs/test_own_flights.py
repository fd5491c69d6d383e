"""How long a target may be asked to fly at once between two points of an evaluation."""

from __future__ import annotations

import pytest
from robots_that_learn import LaggedRobot

from nufleet.orchestrator.jobs.evaluate import check_own_flights
from nufleet.shared.errors import InvalidInputError


def test_more_flying_at_once_than_a_robot_may_do_is_refused_with_the_remedy() -> None:
    spec = LaggedRobot().spec
    allowed_s = spec.duration_max_s - spec.settling_time_s
    check_own_flights((0.0, 5.0, 5.0 + allowed_s), spec, "target")
    with pytest.raises(InvalidInputError, match="robot target fly for") as refused:
        check_own_flights((0.0, 6.0 + allowed_s), spec, "target")
    assert "add a duration in between" in str(refused.value)
