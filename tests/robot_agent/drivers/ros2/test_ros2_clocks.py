"""Times of measurements: on one clock, in order, or refused."""

from __future__ import annotations

import threading
from typing import Any

import numpy as np
import pytest

from nufleet.robot_agent.drivers.ros2.clocks import Arrivals, on_receiving_clock
from nufleet.shared.errors import RobotError

PLACE = {"x": 0.1, "y": 0.2}


def arrivals(stamps: Any = "own-clock") -> Arrivals:
    return Arrivals("/cf1/odom", ("y", "x"), stamps)


@pytest.mark.parametrize(("drift", "lasts_s"), [(0.0, 3.0), (40e-6, 60.0), (-200e-6, 60.0)])
def test_a_foreign_clock_is_read_through_the_messages_that_travelled_fastest(
    drift: float, lasts_s: float
) -> None:
    rng = np.random.default_rng(3)
    true_s = 50.0 + np.arange(0.0, lasts_s, 0.01)
    stamp_s = 1.7e9 + (1 + drift) * true_s
    arrived_s = np.maximum.accumulate(true_s + 0.003 + rng.exponential(0.008, len(true_s)))
    found_s = on_receiving_clock(stamp_s, arrived_s)
    # All that is unknown are the 3 ms that even the fastest messages took.
    assert np.abs(found_s - true_s - 0.003).max() < 0.3e-3
    assert (found_s <= arrived_s + 1e-6).all()


def test_simulated_stamps_may_come_before_the_clock_that_they_are_of() -> None:
    kept = arrivals("simulated")
    kept.take(7.1, 7.0, PLACE)
    assert kept.since(7.0)[0].tolist() == [7.1]


def test_few_messages_tell_an_offset_and_no_drift() -> None:
    found_s = on_receiving_clock(np.array([7.0, 7.01, 7.02]), np.array([1.005, 1.02, 1.023]))
    assert found_s == pytest.approx([1.003, 1.013, 1.023])


@pytest.mark.parametrize(("rate", "said"), [(1.005, "0.50% slower"), (0.995, "0.50% faster")])
def test_clocks_that_differ_by_more_than_clocks_do_are_refused(rate: float, said: str) -> None:
    stamp_s = np.arange(0.0, 10.0, 0.01)
    with pytest.raises(RobotError, match=f"run {said} than this computer's clock"):
        on_receiving_clock(stamp_s, rate * stamp_s + 5.0)


def test_delays_that_change_by_little_are_no_other_rate() -> None:
    stamp_s = np.arange(0.0, 6.0, 0.01)
    found_s = on_receiving_clock(stamp_s, stamp_s + 5.0 + 0.02 * (stamp_s < 0.5))
    assert np.diff(found_s).max() < 0.01 * 1.0011


def test_measurements_are_given_in_the_order_of_the_components() -> None:
    kept = arrivals("arrival")
    kept.take(None, 5.0, PLACE)
    kept.take(None, 5.01, {"x": 0.3, "y": 0.4, "z": 9.0})
    times_s, values = kept.since(5.0)
    assert times_s.tolist() == [5.0, 5.01]
    assert values.tolist() == [[0.2, 0.1], [0.4, 0.3]]


def test_a_motions_measurements_begin_with_the_last_one_before_it() -> None:
    kept = arrivals("synchronised")
    for k in range(10):
        kept.take(1.0 + k, 1.001 + k, PLACE)
    assert kept.since(4.5)[0].tolist() == [4.0, 5.0, 6.0, 7.0, 8.0, 9.0, 10.0]
    assert arrivals().since(0.0)[1].shape == (0, 2)


def test_a_message_that_waited_is_no_jump_of_its_clock() -> None:
    kept = arrivals()
    for stamp_s, arrived_s in ((7.0, 1.0), (7.01, 2.5), (7.02, 2.5), (8.6, 2.6)):
        kept.take(stamp_s, arrived_s, PLACE)
    assert kept.since(0.0)[0] == pytest.approx([1.0, 1.01, 1.02, 2.6])


@pytest.mark.parametrize(("stamps", "late_s"), [("own-clock", 0.6), ("synchronised", 0.605)])
def test_a_measurement_knows_how_late_it_arrived_also_on_a_clock_that_drifts(
    stamps: Any, late_s: float
) -> None:
    kept = arrivals(stamps)
    drift = 0.0 if stamps == "synchronised" else 3e-4
    for k in range(3600):
        kept.take((1 - drift) * k, k + 0.005, PLACE)
    newest = kept.newest()
    assert newest is not None
    assert newest.late_s <= 0.005 + 1e-9
    kept.take((1 - drift) * 3600, 3600.605, PLACE)
    newest = kept.newest()
    assert newest is not None
    assert newest.late_s == pytest.approx(late_s, abs=1e-3)


def test_of_a_burst_after_a_delay_the_first_measurement_counts() -> None:
    kept = arrivals("arrival")
    for at_s in (1.0, 1.01, 1.02, 1.06, 1.0601, 1.0602, 1.07):
        kept.take(None, at_s, PLACE)
    assert kept.since(1.0)[0] == pytest.approx([1.0, 1.01, 1.02, 1.06, 1.07])


def test_a_repetition_is_passed_over() -> None:
    kept = arrivals()
    kept.take(7.0, 1.0, PLACE)
    kept.take(7.0, 1.01, {"x": 9.0, "y": 9.0})
    newest = kept.newest()
    assert newest is not None
    assert newest.values == PLACE


@pytest.mark.parametrize(
    ("stamps", "second", "said"),
    [
        ("own-clock", (6.5, 7.01, PLACE), "went back by 0.5 s: its clock was set, or two programs"),
        ("own-clock", (9.0, 7.01, PLACE), "jumped by 1.9[89] s: its clock was set"),
        ("own-clock", (None, 7.01, PLACE), 'have no time stamp: .* stamps = "arrival"'),
        ("own-clock", (7.01, 7.01, {"x": 1.0}), "/cf1/odom has no y; it has x"),
        ("own-clock", (7.01, 7.01, {"x": np.nan, "y": 0.0}), "reported a x that is not finite"),
        ("synchronised", (8.0, 7.5, PLACE), "0.5 s ahead of this computer's clock"),
    ],
)
def test_a_measurement_that_cannot_be_is_refused_and_so_is_all_after_it(
    stamps: Any, second: Any, said: str
) -> None:
    kept = arrivals(stamps)
    kept.take(4.0, 4.0, PLACE)
    kept.take(7.0, 7.0, PLACE)
    kept.take(*second)
    kept.take(9.0, 9.0, PLACE)
    with pytest.raises(RobotError, match=said):
        kept.newest()
    with pytest.raises(RobotError, match=said):
        kept.next(0.0)
    assert kept.since(0.0)[1].shape == (2, 2)


def test_a_first_message_that_waited_is_no_jump_of_its_clock() -> None:
    kept = arrivals()
    kept.take(7.0, 8.5, PLACE)
    kept.take(8.5, 8.51, PLACE)
    assert kept.newest() is not None


def test_messages_about_other_joints_are_no_measurements() -> None:
    kept = arrivals()
    kept.take(7.0, 1.0, {"gripper": 0.0})
    assert kept.newest() is None
    with pytest.raises(RobotError, match=r"nothing came of y, x on /cf1/odom .* only gripper"):
        kept.next(0.0)


def test_the_next_measurement_is_waited_for() -> None:
    kept = arrivals()
    kept.take(7.0, 1.0, PLACE)
    later = threading.Timer(0.05, kept.take, (8.0, 2.0, {"x": 3.0, "y": 4.0}))
    later.start()
    assert kept.next(60.0).values == {"x": 3.0, "y": 4.0}
    later.join()
