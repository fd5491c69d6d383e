"""From a robot's `begin` to its `end`: in the air, or on the ground."""

from __future__ import annotations

import logging

from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotDownError, RobotError

_log = logging.getLogger(__name__)


class Sortie:
    """Begins a robot before its first motion and ends it after its last one; for one thread."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.begun = False

    def begin(self) -> None:
        """Get the robot ready to move unless it is.

        Raises:
            RobotError: It could not begin, and was ended again.
            RobotDownError: It could not begin, and cannot be ended either.
        """
        if self.begun:
            return
        self.begun = True  # half a take-off has to be ended, too
        try:
            self._robot.begin()
        except Exception as error:
            failed = f"could not get ready to move: {_words(error)}"
            also = self.end()
            if isinstance(error, RobotDownError) or also is not None:
                raise RobotDownError(failed if also is None else f"{failed}; {also}") from error
            raise RobotError(failed) from error

    def end(self) -> str | None:
        """Land the robot if it has begun; return why that failed, None when it has ended."""
        if not self.begun:
            return None
        self.begun = False  # a robot that could not be ended has a fault, and is asked no more
        try:
            self._robot.end()
        except Exception as error:  # noqa: BLE001 - a driver's mistake must not end the thread
            return f"could not be ended: {_words(error)}"
        return None


def _words(error: Exception) -> str:
    if isinstance(error, RobotError):
        return str(error)
    _log.error("a driver failed unexpectedly", exc_info=error)
    return repr(error)
