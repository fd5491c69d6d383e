"""Device time to ours by TIMESYNC: how far off it may be, and how far off it is."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.robot_agent.drivers.mavlink.clock import VehicleClock


def compared(
    rng: np.random.Generator, *, up_s: float, down_s: float, jitter_s: float, drift: float
) -> VehicleClock:
    """A minute of exchanges with a clock that shows 1000 s more, and drifts."""
    clock = VehicleClock()
    for sent_s in np.arange(0.0, 60.0, 0.1):
        there_s = sent_s + up_s + jitter_s * rng.exponential()
        back_s = there_s + down_s + jitter_s * rng.exponential()
        clock.answered(clock.request(sent_s), 1000.0 + (1 + drift) * there_s, back_s)
    return clock


@given(
    seed=st.integers(0, 1000),
    up_s=st.floats(0.0, 0.05),
    down_s=st.floats(0.0, 0.05),
    jitter_s=st.floats(0.0, 0.03),
    drift=st.floats(-5e-5, 5e-5),
)
def test_the_true_offset_lies_within_the_bound_whatever_the_link_does(
    seed: int, up_s: float, down_s: float, jitter_s: float, drift: float
) -> None:
    rng = np.random.default_rng(seed)
    clock = compared(rng, up_s=up_s, down_s=down_s, jitter_s=jitter_s, drift=drift)
    at_s = np.linspace(1.0, 59.0, 7)
    offset, bound = clock.offset(at_s)
    assert (np.abs(offset - (1000.0 + drift * at_s)) <= bound + 1e-9).all()


def test_jitter_of_8_ms_leaves_a_tenth_of_it_in_the_clock_and_a_bound_that_says_so() -> None:
    clock = compared(np.random.default_rng(1), up_s=0.001, down_s=0.001, jitter_s=8e-3, drift=2e-5)
    at_s = np.linspace(5.0, 55.0, 11)
    offset, bound = clock.offset(at_s)
    assert np.abs(offset - (1000.0 + 2e-5 * at_s)).max() < 0.8e-3
    assert bound.max() < 2e-3
    converted = clock.ours(1000.0 + (1 + 2e-5) * at_s)
    assert np.abs(converted - at_s).max() < 0.8e-3


def test_an_answer_to_the_request_of_another_ground_station_is_ignored() -> None:
    clock = VehicleClock()
    clock.request(1.0)
    clock.answered(123_456, 7.0, 1.01)
    assert clock.exchanges == 0
    assert clock.offset(np.array([1.0]))[1] == pytest.approx(np.inf)
