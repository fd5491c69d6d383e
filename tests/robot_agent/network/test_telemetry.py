"""Telemetry: every sample once and in order, in few messages, and never in a motion's way."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.robot_agent.network.telemetry import PERIOD_S, TelemetryBatcher
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import TransportError
from nufleet.shared.wire.codec import decode
from nufleet.shared.wire.messages import Telemetry
from nufleet.shared.wire.requests import Publisher


@dataclass
class Wire:
    """Stands in for a Zenoh publisher."""

    sent: list[bytes] = field(default_factory=list)
    broken: bool = False
    matching: bool = True

    @property
    def matching_status(self) -> Wire:
        return self

    def put(self, payload: bytes) -> None:
        if self.broken:
            raise TransportError("the link is gone")
        self.sent.append(payload)


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


def batcher(wire: Wire, clock: Clock) -> TelemetryBatcher:
    return TelemetryBatcher(Publisher(wire), message, clock=clock)


def message(first: int, signals: tuple[FloatArray, ...]) -> Telemetry:
    reference, response = signals
    return Telemetry(
        goal_id="g",
        first_sample=first,
        sample_time_s=0.01,
        reference=reference,
        response=response,
    )


def received(wire: Wire) -> list[Telemetry]:
    return [decode(payload, Telemetry) for payload in wire.sent]


@settings(max_examples=60, deadline=None)
@given(
    batches=st.lists(st.tuples(st.integers(0, 30), st.floats(0, 0.3)), max_size=40),
)
def test_every_sample_is_sent_once_in_order_and_no_faster_than_the_period(
    batches: list[tuple[int, float]],
) -> None:
    wire, clock = Wire(), Clock()
    telemetry = batcher(wire, clock)
    first = 0
    for samples, wait_s in batches:
        clock.now_s += wait_s
        indices = np.arange(first, first + samples, dtype=float)
        telemetry.add(first, indices, -indices)
        first += samples
    elapsed_s = clock.now_s - 100.0
    assert len(wire.sent) <= elapsed_s / PERIOD_S + 1e-9
    telemetry.flush()
    telemetry.flush()
    messages = received(wire)
    assert all(m.goal_id == "g" and m.sample_time_s == 0.01 for m in messages)
    follows = 0
    for message in messages:
        assert message.first_sample == follows
        expected = np.arange(follows, follows + len(message.reference), dtype=float)
        np.testing.assert_array_equal(message.reference, expected)
        np.testing.assert_array_equal(message.response, -expected)
        follows += len(message.reference)
    assert follows == first


def test_nothing_is_sent_before_the_period_is_over_or_when_there_is_nothing() -> None:
    wire, clock = Wire(), Clock()
    telemetry = batcher(wire, clock)
    telemetry.flush()
    assert not wire.sent
    telemetry.add(0, np.ones(3), np.ones(3))
    assert not wire.sent
    clock.now_s += 1.5 * PERIOD_S
    telemetry.add(3, np.ones(2), np.ones(2))
    (message,) = received(wire)
    assert (message.first_sample, len(message.reference)) == (0, 5)


@pytest.mark.parametrize("matching", [True, False])
def test_whether_anybody_listens_is_known_from_the_first_batch_on(matching: bool) -> None:
    wire, clock = Wire(matching=matching), Clock()
    telemetry = batcher(wire, clock)
    assert telemetry.heard
    clock.now_s += 1.5 * PERIOD_S
    telemetry.add(0, np.ones(3), np.ones(3))
    assert telemetry.heard == matching


def test_samples_that_nobody_listens_to_are_not_sent_later_either() -> None:
    wire, clock = Wire(matching=False), Clock()
    telemetry = batcher(wire, clock)
    telemetry.add(0, np.ones(3), np.ones(3))
    telemetry.flush()
    wire.matching = True
    telemetry.add(3, np.zeros(2), np.zeros(2))
    telemetry.flush()
    (message,) = received(wire)
    assert (message.first_sample, len(message.reference)) == (3, 2)


def test_a_broken_link_loses_samples_and_disturbs_nobody() -> None:
    wire, clock = Wire(broken=True), Clock()
    telemetry = batcher(wire, clock)
    telemetry.add(0, np.ones(3), np.ones(3))
    telemetry.flush()
    wire.broken = False
    telemetry.add(3, np.zeros(2), np.zeros(2))
    telemetry.flush()
    (message,) = received(wire)
    assert (message.first_sample, len(message.reference)) == (3, 2)
