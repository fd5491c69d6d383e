"""Asks a driver for its robot's health, on a thread that nothing else waits for."""

from __future__ import annotations

import logging
import threading
import time

from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.health import Health

_log = logging.getLogger(__name__)


class HealthWatch:
    """Keeps the health that a connected robot reported last, and how old it is.

    A robot that reports none when it is connected is not asked again.
    """

    def __init__(self, name: str, robot: Robot, interval_s: float) -> None:
        """Ask for the first time, and keep asking until `close`.

        Args:
            name: Name of the robot.
            robot: The robot, connected.
            interval_s: Time between two questions.
        """
        self._robot, self._interval_s = robot, interval_s
        self._closing = threading.Event()
        self._newest = (self._asked(), time.monotonic())
        if self._newest[0] is not None:
            # It is not joined: a driver that hangs must not keep the agent from ending.
            threading.Thread(target=self._ask, name=f"{name}-health", daemon=True).start()

    @property
    def newest(self) -> tuple[Health | None, float]:
        """The last health, or None for a robot that reports none, and its age in s."""
        health, reported_s = self._newest
        return health, time.monotonic() - reported_s

    def close(self) -> None:
        """Ask no more."""
        self._closing.set()

    def _ask(self) -> None:
        while not self._closing.wait(self._interval_s):
            self._newest = (self._asked(), time.monotonic())

    def _asked(self) -> Health | None:
        try:
            return self._robot.health()
        except RobotError as error:
            return Health(ready=False, reason=str(error) or "its driver cannot tell its health")
        except Exception as error:  # noqa: BLE001 - a driver's mistake is reported as its health
            _log.exception("a driver could not tell its robot's health")
            return Health(ready=False, reason=f"an unexpected error: {error!r}")
