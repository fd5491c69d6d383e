"""A robot paced by a clock: what counts as late, and the flight that is timed."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.control_period import fly_by_the_clock, laps
from benchmarks.planar_robot import ClockedRobot, planar_double_integrator, tracking_limits
from nufleet.shared.paths.trajectories import check_trajectory


class Clock:
    """Time that passes only when the code under test sleeps or takes some."""

    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept_s: list[float] = []

    def __call__(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.slept_s.append(duration_s)
        self.now_s += duration_s


def test_ticks_stay_where_they_are_when_a_reference_is_late() -> None:
    clock = Clock()
    robot = ClockedRobot(planar_double_integrator(0.0), clock, clock.sleep)
    for choosing_s in (0.001, 0.020, 0.004, 0.002):
        robot.observe()
        clock.now_s += choosing_s
        robot.step(np.zeros(2))
    # The second reference is 5 ms late, so the third sample begins 5 ms after its tick.
    np.testing.assert_allclose(robot.reference_s, [0.001, 0.020, 0.009, 0.002], atol=1e-9)
    np.testing.assert_allclose(clock.slept_s, [0.014, 0.006], atol=1e-9)


def test_it_does_with_a_clock_what_it_does_without() -> None:
    clock, rng = Clock(), np.random.default_rng(0)
    clocked = ClockedRobot(planar_double_integrator(0.001), clock, clock.sleep)
    free = planar_double_integrator(0.001)
    assert (clocked.spec, clocked.state_names) == (free.spec, free.state_names)
    assert [axis.name for axis in free.spec.axes] == ["x", "y"]
    for reference in 0.01 * rng.standard_normal((20, 2)):
        np.testing.assert_array_equal(clocked.observe(), free.observe())
        np.testing.assert_array_equal(clocked.step(reference), free.step(reference))
    assert len(clocked.reference_s) == 20


def test_laps_last_as_long_as_asked_and_keep_to_the_limits() -> None:
    desired = laps(150.0, 0.015)
    assert desired.shape == (10_000, 2)
    check_trajectory(desired, 0.015, tracking_limits(planar_double_integrator(0.0)))


def test_a_flight_by_the_clock_takes_its_time_and_tracks() -> None:
    flight = fly_by_the_clock(0.04, training_steps_max=20)
    assert flight.samples == 160
    assert flight.minutes == pytest.approx(0.04)
    assert flight.arrival_worst_ms >= flight.choosing_worst_ms > 0
    assert flight.misses >= flight.choices_too_long
    assert flight.rms_error_mm < 0.5 * flight.baseline_rms_error_mm
    assert flight.taken_back is None
