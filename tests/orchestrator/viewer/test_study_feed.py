"""What a viewer is told of a study and its fleet."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import cast

import numpy as np
import pytest

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.study.interface import Question, Report, SourceEstimate, StudyPlan
from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.events import (
    IterationEvent,
    MessageEvent,
    RobotStateEvent,
    TestSamplesEvent,
    ViewerEvent,
)
from nufleet.orchestrator.viewer.study_feed import LiveView, drawn_of
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.wire.messages import RobotState, RobotStatus, Telemetry

PLAN = StudyPlan("target", ("source-1",), (0.1, 10.0), 3, "x")


class ObservedFleet:
    """Keeps the observers that a live view registers, to be called by the test."""

    def __init__(self) -> None:
        self.on_state: Callable[[RobotState], None] = lambda state: None
        self.on_telemetry: Callable[[str, Telemetry], None] = lambda robot, telemetry: None

    def observe_states(self, observer: Callable[[RobotState], None]) -> None:
        self.on_state = observer

    def observe_telemetry(self, observer: Callable[[str, Telemetry], None]) -> None:
        self.on_telemetry = observer


def response(**z: complex) -> FrequencyResponse:
    omega = np.array([float(name.removeprefix("w")) for name in z])
    return FrequencyResponse(omega, np.array(list(z.values())), np.zeros(len(z)), 4, Quality())


def report(
    responses: Mapping[str, FrequencyResponse],
    known: Mapping[str, Sequence[FrequencyResponse]] | None = None,
    dropped: Mapping[str, str] = MappingProxyType({}),
) -> Report:
    """What a study says after a round, of which one need not tell all that is known."""
    return Report(
        iteration=1,
        omega_rad_s=(2.0,),
        responses=responses,
        known=known or {},
        sampled_psi={"source-1": 0.1},
        curves=(),
        ranking=(SourceEstimate("source-1", 0.1, 0.08, 0.12, 2.0, 1),),
        dropped=dropped,
    )


def question() -> Question:
    test = Excitation(axis="x", tones=(Tone(omega_rad_s=2.0),))
    return Question(1, {"target": test, "source-1": test})


@pytest.fixture
def seen() -> list[ViewerEvent]:
    return []


@pytest.fixture
def fleet() -> ObservedFleet:
    return ObservedFleet()


@pytest.fixture
def view(seen: list[ViewerEvent], fleet: ObservedFleet) -> LiveView:
    live = LiveView(PLAN, "m", ViewerClock(lambda: 0.0), seen.append)
    live.watch(cast(Fleet, fleet))
    return live


def state(robot: str) -> RobotState:
    return RobotState(
        robot=robot,
        boot_id="b",
        sequence=1,
        status=RobotStatus.RUNNING,
        goal_id="g",
        progress=0.5,
        reason="",
        last_goal_id=None,
        robot_time_s=1.0,
    )


def test_states_of_the_study_s_robots_are_drawn_and_of_others_not(
    view: LiveView, fleet: ObservedFleet, seen: list[ViewerEvent]
) -> None:
    fleet.on_state(state("target"))
    fleet.on_state(state("bystander"))
    (event,) = seen
    assert isinstance(event, RobotStateEvent)
    assert (event.robot, event.status, event.progress) == ("target", "running", 0.5)


def test_nothing_is_drawn_of_the_fleet_after_the_study(
    view: LiveView, fleet: ObservedFleet, seen: list[ViewerEvent]
) -> None:
    view.stop_watching()
    fleet.on_state(state("target"))
    assert not seen


def test_running_samples_are_drawn_at_their_place_in_the_test(
    view: LiveView, fleet: ObservedFleet, seen: list[ViewerEvent]
) -> None:
    view.asked(question())
    samples = np.zeros(5)
    telemetry = Telemetry(
        goal_id="g", first_sample=100, sample_time_s=0.02, reference=samples, response=samples
    )
    fleet.on_telemetry("source-1", telemetry)
    running, event = seen
    assert isinstance(running, RobotStateEvent)
    assert (running.robot, running.status) == ("source-1", "running")
    assert isinstance(event, TestSamplesEvent)
    assert running.t_s == event.t_s == pytest.approx(2.0)
    assert (event.tones, event.target) == ((Tone(omega_rad_s=2.0),), "target")


def test_a_robot_that_outruns_the_clock_is_running_while_its_samples_are_drawn(
    view: LiveView, fleet: ObservedFleet, seen: list[ViewerEvent]
) -> None:
    view.asked(question())
    samples = np.zeros(500)
    for first in (0, 500):
        fleet.on_telemetry(
            "target",
            Telemetry(
                goal_id="g",
                first_sample=first,
                sample_time_s=0.02,
                reference=samples,
                response=samples,
            ),
        )
        fleet.on_state(state("target").model_copy(update={"status": RobotStatus.RESTING}))
    lanes = [(e.t_s, e.status) for e in seen if isinstance(e, RobotStateEvent)]
    assert lanes == [(0.0, "running"), (10.0, "resting"), (10.0, "running"), (20.0, "resting")]


def test_a_robot_at_rest_again_before_its_samples_arrive_is_still_shown_running(
    view: LiveView, fleet: ObservedFleet, seen: list[ViewerEvent]
) -> None:
    view.asked(question())
    resting = state("target").model_copy(update={"status": RobotStatus.RESTING})
    stopped = state("source-1").model_copy(update={"status": RobotStatus.STOPPED})
    fleet.on_state(resting)
    assert not seen
    fleet.on_state(stopped)  # what concerns a person is shown at once
    samples = np.zeros(5)
    telemetry = Telemetry(
        goal_id="g", first_sample=0, sample_time_s=0.02, reference=samples, response=samples
    )
    fleet.on_telemetry("target", telemetry)
    fleet.on_state(resting)
    lanes = [(e.robot, e.status) for e in seen if isinstance(e, RobotStateEvent)]
    assert lanes == [("source-1", "stopped"), ("target", "running"), ("target", "resting")]


def test_a_failed_attempt_is_logged(view: LiveView, seen: list[ViewerEvent]) -> None:
    view.attempt_failed("source-1", 2, "it did not settle")
    (event,) = seen
    assert isinstance(event, MessageEvent)
    assert "source-1" in event.text
    assert "it did not settle" in event.text


def test_a_round_is_drawn_with_what_it_taught_and_who_was_lost(
    view: LiveView, seen: list[ViewerEvent]
) -> None:
    told = report(
        responses={"target": response(w2=1.0), "source-1": response(w2=0.9)},
        dropped={"source-9": "lost"},
    )
    view.asked(question())
    view.told(question(), {}, told)
    (event,) = seen
    assert isinstance(event, IterationEvent)
    assert event.ranking == told.ranking
    assert event.omega_rad_s == (2.0,)
    assert event.responses == {"target": {2.0: 1.0}, "source-1": {2.0: 0.9}}
    assert event.messages == ("without source-9: lost",)


def test_the_best_sources_are_drawn_by_their_earlier_tests_where_the_target_plays_alone() -> None:
    known = {
        "target": [response(w2=1.0, w4=0.5)],
        "source-1": [response(w1=0.9, w2=0.8), response(w2=0.7)],
        "source-8": [response(w2=0.6)],
    }
    omega, z = drawn_of(report(responses={"target": known["target"][0]}, known=known), PLAN)
    assert omega == (2.0, 4.0)
    assert z == {"target": {2.0: 1.0, 4.0: 0.5}, "source-1": {1.0: 0.9, 2.0: 0.7}}


def test_where_the_target_rests_the_tones_of_another_robot_are_drawn() -> None:
    known = {"target": [response(w2=1.0)], "source-1": [response(w2=0.9), response(w3=0.8)]}
    omega, z = drawn_of(report(responses={"source-1": known["source-1"][1]}, known=known), PLAN)
    assert omega == (3.0,)
    assert z == {"target": {2.0: 1.0}, "source-1": {2.0: 0.9, 3.0: 0.8}}


def test_tones_at_which_nothing_could_be_estimated_are_not_drawn() -> None:
    known = {"target": [response(w2=1.0, w4=complex("nan"))], "source-1": [response(w2=0.9)]}
    omega, z = drawn_of(report(responses={"target": known["target"][0]}, known=known), PLAN)
    assert (omega, z) == ((2.0,), {"target": {2.0: 1.0}, "source-1": {2.0: 0.9}})


def test_responses_of_other_axes_than_the_first_are_not_drawn() -> None:
    other = replace(response(w2=0.3), axis="y")
    known = {"target": [response(w2=1.0), other], "source-1": [other]}
    omega, z = drawn_of(report(responses={"target": other}, known=known), PLAN)
    assert (omega, z) == ((), {"target": {2.0: 1.0}, "source-1": {}})
