"""A destination that is slow, stuck or broken costs the study nothing."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator, Sequence

import pytest
from polling import PATIENCE_S
from study_events import iteration_event, samples_event, state_event
from tracking_events import flight

from nufleet.orchestrator.viewer.events import (
    IterationEvent,
    RobotStateEvent,
    TakenBackEvent,
    TrackingSamplesEvent,
    ViewerEvent,
)
from nufleet.orchestrator.viewer.outlet import Outlet
from nufleet.shared.errors import InvalidInputError


class GatedSink:
    """Keeps what it is given; blocks in the first `write` until its gate is opened."""

    def __init__(self) -> None:
        self.entered = threading.Event()
        self.gate = threading.Event()
        self.events: list[ViewerEvent] = []
        self.closed = False

    def write(self, events: Sequence[ViewerEvent]) -> None:
        self.entered.set()
        assert self.gate.wait(PATIENCE_S)
        self.events += events

    def close(self) -> None:
        self.closed = True


class BrokenSink(GatedSink):
    """Fails to write."""

    def write(self, events: Sequence[ViewerEvent]) -> None:
        self.entered.set()
        raise OSError("the disk is full")


@pytest.fixture
def gated() -> Iterator[GatedSink]:
    sink = GatedSink()
    yield sink
    sink.gate.set()


def started(open_sink: Callable[[], GatedSink], **limits: int) -> Outlet:
    outlet = Outlet("test", open_sink, **limits)
    outlet.start()
    outlet.wait_opened(PATIENCE_S)
    return outlet


def finish(outlet: Outlet) -> None:
    outlet.ask_to_close()
    assert outlet.join(PATIENCE_S)


def test_everything_arrives_in_order_before_the_outlet_ends(gated: GatedSink) -> None:
    gated.gate.set()
    outlet = started(lambda: gated)
    events: list[ViewerEvent] = [
        state_event("s1", 0.0),
        iteration_event(1),
        samples_event("s1"),
        iteration_event(2),
        state_event("s1", 1.0),
    ]
    for event in events:
        outlet.offer(event)
    finish(outlet)
    assert gated.events == events
    assert gated.closed
    assert outlet.dropped == 0


def test_offering_never_waits_for_a_sink_that_is_stuck(gated: GatedSink) -> None:
    outlet = started(lambda: gated)
    outlet.offer(state_event("s1", 0.0))
    assert gated.entered.wait(PATIENCE_S)
    # Its gate stays shut: a call that waited for it would not return.
    for k in range(20_000):
        outlet.offer(state_event("s1", 0.1 * k))
    outlet.ask_to_close()
    assert not outlet.join(0.2)
    assert not gated.events


def test_behind_a_slow_sink_the_oldest_telemetry_goes_and_every_iteration_stays(
    gated: GatedSink,
) -> None:
    outlet = started(lambda: gated, waiting_max=10)
    outlet.offer(state_event("s1", 0.0))
    assert gated.entered.wait(PATIENCE_S)
    for k in range(1, 101):
        outlet.offer(state_event("s1", float(k)))
        outlet.offer(iteration_event(k))
    assert outlet.dropped == 90
    gated.gate.set()
    finish(outlet)
    states = [event.t_s for event in gated.events if isinstance(event, RobotStateEvent)]
    rounds = [event.iteration for event in gated.events if isinstance(event, IterationEvent)]
    assert states == [0.0, *range(91, 101)]
    assert rounds == list(range(1, 101))
    assert outlet.dropped == 90


def test_waiting_samples_are_bounded_in_bytes(gated: GatedSink) -> None:
    event = samples_event("s1", samples=1000)
    size = event.reference.nbytes + event.response.nbytes
    outlet = started(lambda: gated, waiting_bytes_max=5 * size)
    outlet.offer(state_event("s1", 0.0))
    assert gated.entered.wait(PATIENCE_S)
    for _ in range(8):
        outlet.offer(event)
    assert outlet.dropped == 3
    gated.gate.set()
    finish(outlet)
    assert len(gated.events) == 6


def test_behind_a_slow_sink_samples_of_flights_go_and_the_guards_event_stays(
    gated: GatedSink,
) -> None:
    event = flight()
    arrays = (event.desired, event.actual, event.prior, event.mean, event.variance, event.share)
    one = sum(array.nbytes for array in arrays)
    outlet = started(lambda: gated, waiting_bytes_max=3 * one)
    outlet.offer(state_event("target", 0.0))
    assert gated.entered.wait(PATIENCE_S)
    outlet.offer(taken_back := TakenBackEvent(1.0, "target", event.flight, "it was worse"))
    for k in range(10):
        outlet.offer(flight(t_s=15.0 * k))
    assert outlet.dropped == 7
    gated.gate.set()
    finish(outlet)
    assert taken_back in gated.events
    assert sum(isinstance(e, TrackingSamplesEvent) for e in gated.events) == 3


def test_a_sink_that_fails_takes_nothing_more_and_what_it_misses_is_counted(
    caplog: pytest.LogCaptureFixture,
) -> None:
    sink = BrokenSink()
    outlet = started(lambda: sink)
    outlet.offer(iteration_event(1))
    outlet.offer(iteration_event(2))
    assert outlet.join(PATIENCE_S)
    outlet.offer(iteration_event(3))
    assert outlet.dropped == 3
    assert "the disk is full" in caplog.text


def test_what_opening_a_sink_raises_is_raised_to_who_waits_for_it() -> None:
    def refuse() -> GatedSink:
        raise InvalidInputError("no such folder")

    outlet = Outlet("test", refuse)
    outlet.start()
    with pytest.raises(InvalidInputError, match="no such folder"):
        outlet.wait_opened(PATIENCE_S)
    outlet.offer(iteration_event(1))
    assert outlet.dropped == 1


def test_after_it_was_asked_to_close_an_outlet_drops_and_counts(gated: GatedSink) -> None:
    gated.gate.set()
    outlet = started(lambda: gated)
    finish(outlet)
    outlet.offer(iteration_event(1))
    assert outlet.dropped == 1
    assert gated.events == []
