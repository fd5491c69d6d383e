"""A driver is asked for its robot's health, and one that cannot answer holds up nothing."""

from __future__ import annotations

import threading

from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.robot_agent.motion.health_watch import HealthWatch
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.health import Health


def test_the_newest_report_is_known() -> None:
    robot = PuppetRobot()
    robot.reports = lambda: Health(battery=0.5)
    watch = HealthWatch("r", robot, 0.001)
    assert watch.newest[0] == Health(battery=0.5)
    robot.reports = lambda: Health(battery=0.4)
    wait_until(lambda: watch.newest[0] == Health(battery=0.4))
    watch.close()


def test_a_robot_that_reports_nothing_is_asked_once() -> None:
    threads = threading.active_count()
    watch = HealthWatch("r", PuppetRobot(), 0.001)
    assert watch.newest[0] is None
    assert threading.active_count() == threads


def test_a_driver_that_fails_to_report_makes_its_robot_unready() -> None:
    for error, words in ((RobotError("no link"), "no link"), (OSError("x"), "OSError('x')")):

        def fails(error: Exception = error) -> Health:
            raise error

        robot = PuppetRobot()
        robot.reports = fails
        watch = HealthWatch("r", robot, 10.0)
        health, _ = watch.newest
        watch.close()
        assert health is not None
        assert not health.ready
        assert words in health.reason


def test_a_report_that_does_not_come_grows_old() -> None:
    robot, goes_on, asked = PuppetRobot(), threading.Event(), threading.Event()
    robot.reports = Health
    watch = HealthWatch("r", robot, 0.001)

    def hangs() -> Health:
        asked.set()
        goes_on.wait(PATIENCE_S)
        return Health()

    robot.reports = hangs
    assert asked.wait(PATIENCE_S)
    first = watch.newest[1]
    wait_until(lambda: watch.newest[1] > first)
    goes_on.set()
    watch.close()
