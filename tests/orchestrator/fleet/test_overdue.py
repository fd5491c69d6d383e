"""A motion is overdue when its time is over and it gets no further."""

from __future__ import annotations

from nufleet.orchestrator.fleet.overdue import Overdue


def test_a_motion_that_takes_its_time_is_not_overdue() -> None:
    motion = Overdue(100.0, now_s=0.0)
    assert not motion.is_late(0.0, 100.0)
    assert not motion.is_late(0.0, 179.9)
    assert motion.is_late(0.0, 180.0)


def test_one_that_gets_further_is_waited_for() -> None:
    motion = Overdue(0.0, now_s=0.0)
    assert not any(motion.is_late(k / 100, 100.0 * k) for k in range(1, 101))
    assert motion.progress == 1.0


def test_one_that_stands_still_is_not() -> None:
    motion = Overdue(10.0, now_s=0.0)
    assert not motion.is_late(0.5, 40.0)
    assert not motion.is_late(0.5, 69.9)
    assert motion.is_late(0.5, 70.0)
