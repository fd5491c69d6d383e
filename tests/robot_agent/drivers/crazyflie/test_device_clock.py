"""Measurements are dated by the device that took them, not by when they arrived."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.robot_agent.drivers.crazyflie.device_clock import STAMP_MS, DeviceClock
from nufleet.shared.arrays import FloatArray


def dated(
    taken_s: FloatArray, delays_s: FloatArray, *, skew: float = 0.0, offset_s: float = 77.0
) -> FloatArray:
    """Dates of measurements that a clock of its own stamped, off by what was lost of them."""
    clock = DeviceClock()
    stamps = np.rint(1000 * ((1 + skew) * taken_s + offset_s)).astype(int)
    devices = [
        clock.take(int(stamp) % STAMP_MS, arrived_s)
        for stamp, arrived_s in zip(stamps, taken_s + delays_s, strict=True)
    ]
    assert clock.fault is None
    return clock.host_s(np.array(devices, dtype=float)) - taken_s


def test_a_jitter_of_many_milliseconds_leaves_dates_right_to_one() -> None:
    rng = np.random.default_rng(1)
    taken_s = 500.0 + 0.01 * np.arange(3000)
    off_s = dated(taken_s, 0.002 + rng.exponential(0.008, len(taken_s)))
    assert np.abs(off_s - 0.002).max() < 0.0012  # the smallest delay cannot be told from the offset


def test_quartzes_that_drift_apart_are_followed_for_minutes() -> None:
    rng = np.random.default_rng(2)
    taken_s = 0.01 * np.arange(20_000)
    off_s = dated(taken_s, rng.exponential(0.004, len(taken_s)), skew=5e-5)
    assert np.abs(off_s[-8000:]).max() < 0.0015  # without the drift it would be 4 ms
    assert np.ptp(off_s[-8000:]) < 0.0025


def test_stamps_begin_again_after_24_bits() -> None:
    taken_s = 0.01 * np.arange(400)
    off_s = dated(taken_s, np.full(400, 0.001), offset_s=STAMP_MS / 1000 - 2.0)
    assert np.abs(off_s - 0.001).max() < 0.0011


def test_packets_that_overtake_each_other_are_dated_all_the_same() -> None:
    taken_s = 0.01 * np.arange(100)
    delays_s = np.where(np.arange(100) % 2, 0.001, 0.018)
    order = np.argsort(taken_s + delays_s)
    off_s = dated(taken_s[order], delays_s[order])
    assert np.abs(off_s - 0.001).max() < 0.0011


@pytest.mark.parametrize(
    ("jump_ms", "says"),
    [(-5000, "go back by 4.94 s"), (5000, "jump ahead by"), (-2_000_000, "go back")],
)
def test_a_clock_that_jumps_is_no_clock(jump_ms: int, says: str) -> None:
    clock = DeviceClock()
    for k in range(10):
        assert clock.take(5_000_000 + 10 * k, 0.01 * k) is not None
    for k in range(6):  # a few may be packets that were held up
        assert clock.fault is None
        assert clock.take((5_000_100 + jump_ms + 10 * k) % STAMP_MS, 0.1 + 0.01 * k) is None
    assert clock.fault is not None
    assert says in clock.fault


def test_a_machine_that_froze_takes_up_where_it_was() -> None:
    clock = DeviceClock()
    taken_s = 0.01 * np.arange(600)
    arrived_s = np.maximum(taken_s, 4.0)  # all that came in four seconds is read at once
    assert all(
        clock.take(round(1000 * taken), arrived) is not None
        for taken, arrived in zip(taken_s, arrived_s, strict=True)
    )
    assert clock.host_s(taken_s) == pytest.approx(taken_s, abs=1e-6)
