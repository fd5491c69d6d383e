"""Planned flights are those that the robots will fly: their references, durations and bounds."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from robots_that_learn import LIMITS, LaggedRobot

from nufleet.orchestrator.experience.learning import planned_lessons
from nufleet.orchestrator.flights.legs import legs_of
from nufleet.orchestrator.flights.planned import Outlook, path_motion, rich_motion
from nufleet.orchestrator.runs.plan_picture import draw_plan
from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.plan import plan_flight
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.motions import Flight, RichFlight, StepTest, Tracking

ROBOT = Description(robot="a", boot_id="1", spec=LaggedRobot().spec)


def duration_on_the_robot_s(motion: Flight) -> float:
    return plan_flight(motion, ROBOT.spec, (), Memory(None), "a").duration_s


def test_a_path_is_planned_with_its_approach_as_the_robot_plans_it() -> None:
    points = np.array([[0.2, 0.3], [0.6, -0.1], [0.4, 0.2]])
    (leg,) = legs_of({"hook": points}, (0.3,), ROBOT)
    alone = path_motion(ROBOT, leg, corrected=False)
    flight = Tracking(inverse="baseline", desired=leg.desired)
    assert alone.duration_s == pytest.approx(duration_on_the_robot_s(flight))
    assert alone.path[0] == (0.0,) * len(ROBOT.spec.axes)
    assert alone.path[-1] == pytest.approx(leg.desired[-1], abs=1e-4)
    corrected = path_motion(ROBOT, leg, corrected=True, times=3)
    assert corrected.high["x"] == pytest.approx(alone.high["x"] + LIMITS.correction_max)
    assert corrected.velocity == pytest.approx(alone.velocity + LIMITS.correction_speed_max)
    (robot,) = Outlook(headline="", motions=(corrected,)).with_healths({}).robots
    assert robot.duration_s == pytest.approx(3 * alone.duration_s)


def test_lessons_are_planned_as_the_robot_plans_them() -> None:
    rich, *steps, practice = planned_lessons(ROBOT, ("preview",), seed=4, duration_s=60.0)
    assert rich.duration_s == pytest.approx(
        duration_on_the_robot_s(RichFlight(duration_s=60.0, seed=4))
    )
    for axis, motion in zip(ROBOT.spec.axes, steps, strict=True):
        assert motion.duration_s == pytest.approx(duration_on_the_robot_s(StepTest(axis=axis.name)))
        assert list(motion.high) == [axis.name]
    assert practice.times == 8
    assert planned_lessons(ROBOT, ("state", "preview"), seed=4)[-1].times == 24


def test_a_robot_that_does_not_track_has_no_flight_to_plan() -> None:
    spec = ROBOT.spec.model_copy(update={"tracking": None})
    with pytest.raises(InvalidInputError, match="has no tracking limits"):
        rich_motion(ROBOT.model_copy(update={"spec": spec}), duration_s=5.0, seed=0)


def test_motions_are_drawn_over_time_and_over_the_plane(tmp_path: Path) -> None:
    motions = planned_lessons(ROBOT, ("preview",), seed=4, duration_s=10.0)
    draw_plan(tmp_path / "plan.svg", Outlook(headline="lessons of a", motions=motions))
    assert "<!-- lessons of a -->" in (tmp_path / "plan.svg").read_text()
