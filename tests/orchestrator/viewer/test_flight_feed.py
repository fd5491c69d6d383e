"""Flights along paths are drawn as they are flown: all of each, under its own name."""

from __future__ import annotations

import numpy as np
from flown_paths import STEP_S, flight, line
from robots_that_learn import LaggedRobot

from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.events import (
    MessageEvent,
    TakenBackEvent,
    TrackingSamplesEvent,
    ViewerEvent,
)
from nufleet.orchestrator.viewer.flight_feed import PathView
from nufleet.shared.wire.messages import TrackingTelemetry
from nufleet.shared.wire.motions import TakenBack

SPEC = LaggedRobot().spec
PATH = line(100, 2)


class Shown:
    """A view on a clock that stands still, and what it emitted."""

    def __init__(self) -> None:
        self.events: list[ViewerEvent] = []
        self.clock = ViewerClock(lambda: 7.0)
        self.view = PathView(self.clock, self.events.append)

    def stream(self, first: int, last: int, goal_id: str = "f1", robot: str = "target") -> None:
        """Let samples of a flight arrive."""
        part = PATH[first:last]
        telemetry = TrackingTelemetry(
            goal_id=goal_id,
            first_sample=first,
            sample_time_s=STEP_S,
            desired=part,
            actual=part + 0.1,
            prior=part,
            mean=part,
            variance=part,
            share=np.ones(len(part)),
        )
        self.view._on_telemetry(robot, telemetry)

    @property
    def samples(self) -> list[TrackingSamplesEvent]:
        return [event for event in self.events if isinstance(event, TrackingSamplesEvent)]


def test_samples_are_drawn_when_they_arrive_with_what_they_are_of() -> None:
    shown = Shown()
    shown.view.begins("target", "source-1 · clover", SPEC)
    shown.stream(0, 40)
    shown.stream(40, 100)
    first, second = shown.samples
    assert (first.robot, first.flight, first.axes, first.unit) == (
        "target",
        "source-1 · clover",
        ("x", "y"),
        "m",
    )
    np.testing.assert_array_equal(second.desired, PATH[40:])
    np.testing.assert_array_equal(second.actual, PATH[40:] + 0.1)
    assert second.t_s - first.t_s == 40 * STEP_S


def test_a_flight_that_was_drawn_whole_is_not_drawn_again() -> None:
    shown = Shown()
    shown.view.begins("target", "a", SPEC)
    shown.stream(0, 100)
    shown.view.ended(flight(PATH, PATH))
    assert len(shown.samples) == 1


def test_what_was_lost_on_the_network_is_drawn_in_the_end() -> None:
    shown = Shown()
    shown.view.begins("target", "a", SPEC)
    shown.stream(0, 40)
    shown.stream(60, 100)
    shown.view.ended(flight(PATH, PATH))
    whole = shown.samples[-1]
    assert len(whole.desired) == 100
    assert whole.t_s == shown.samples[0].t_s


def test_late_samples_of_the_flight_before_are_not_drawn_under_the_next_ones_name() -> None:
    shown = Shown()
    shown.view.begins("target", "first", SPEC)
    shown.stream(0, 90, "f1")
    shown.view.ended(flight(PATH, PATH))
    shown.events.clear()
    shown.view.begins("target", "second", SPEC)
    shown.stream(90, 100, "f1")
    assert shown.samples == []
    shown.stream(0, 50, "f2")
    shown.stream(90, 100, "f1")
    shown.stream(50, 90, "f2")
    assert [len(event.desired) for event in shown.samples] == [50, 40]
    # Ten samples of its own are missing, which the late ones do not stand in for.
    shown.view.ended(flight(PATH, PATH))
    assert len(shown.samples[-1].desired) == 100


def test_other_robots_and_flights_that_nobody_began_are_not_drawn() -> None:
    shown = Shown()
    shown.stream(0, 10)
    shown.view.begins("target", "a", SPEC)
    shown.stream(0, 10, robot="somebody")
    shown.view.ended(flight(PATH[:0], PATH[:0]))
    shown.stream(10, 20)
    assert shown.events == []


def test_a_prior_that_is_taken_back_and_a_failure_are_said_at_their_time() -> None:
    shown = Shown()
    shown.view.begins("target", "a", SPEC)
    began_s = shown.clock.now_s()
    event = TakenBack(sample=25, reason="worse than the baseline")
    shown.view.ended(flight(PATH, PATH, taken_back=event, failure="it fell over"))
    taken_back = next(e for e in shown.events if isinstance(e, TakenBackEvent))
    assert taken_back.t_s == began_s + 25 * STEP_S
    assert (taken_back.robot, taken_back.reason) == ("target", "worse than the baseline")
    message = next(e for e in shown.events if isinstance(e, MessageEvent))
    assert (message.t_s, message.text) == (began_s + 100 * STEP_S, "a: it fell over")


def test_the_next_flight_begins_after_the_one_before_on_the_clock() -> None:
    shown = Shown()
    shown.view.begins("target", "a", SPEC)
    shown.view.ended(flight(PATH, PATH))
    assert shown.clock.now_s() >= 100 * STEP_S
