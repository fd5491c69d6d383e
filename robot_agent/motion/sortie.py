"""From a robot's `begin` to its `end`: in the air, or on the ground."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import Played, Samples
from nufleet.robot_agent.motion.steps import Steps
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.wire.messages import Outcome

_log = logging.getLogger(__name__)


class Sortie:
    """Begins a robot before its first motion and ends it after its last one; for one thread."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.begun = False

    def move(
        self,
        switch: HaltSwitch,
        hindrance: Callable[[], str | None],
        nothing: Samples,
        performed: Callable[[], Steps[Played]],
    ) -> Steps[Played]:
        """Begin the robot unless it is, perform a motion, and end the robot if it has a fault.

        Args:
            switch: Switch of the motion; a robot that was halted before it began does not begin.
            hindrance: Function that returns why a motion may not begin now although its goal was
                accepted, as after a freeze of the whole process; None when it may.
            nothing: Samples of the motion if it does not begin.
            performed: Function that returns the steps of the motion itself, from rest to rest.
        """
        if switch.order is not None:
            return Played(*switch.order, nothing)
        hindered = hindrance()
        if hindered is not None:
            return Played(Outcome.ABORTED, hindered, nothing)
        begins = not self.begun
        self._robot.called_off = lambda: switch.order is not None
        try:
            yield from self.begin()
        except RobotError as error:
            fault = str(error) if isinstance(error, RobotDownError) else None
            ended = switch.order or (Outcome.FAILED, str(error))
            return Played(*ended, nothing, fault)
        if begins and switch.order is not None:
            # It was stopped while it took off; nothing that it could wait for keeps it in the air.
            return Played(*switch.order, nothing, (yield from self.end()))
        hindered = hindrance()
        if hindered is not None:
            return Played(Outcome.ABORTED, hindered, nothing)
        try:
            played = yield from performed()
        except Exception as error:  # noqa: BLE001 - a motion always ends
            _log.exception("a motion ended unexpectedly")
            reason = f"an unexpected error: {error!r}"
            played = Played(Outcome.FAILED, reason, nothing, fault=reason)
        also = None if played.fault is None else (yield from self.end())
        return played if also is None else replace(played, fault=f"{played.fault}; {also}")

    def begin(self) -> Steps[None]:
        """Get the robot ready to move unless it is.

        Raises:
            RobotError: It could not begin, and was ended again.
            RobotDownError: It could not begin, and cannot be ended either.
        """
        if self.begun:
            return
        self.begun = True  # half a take-off has to be ended, too
        try:
            yield self._robot.begin
        except Exception as error:
            failed = f"could not get ready to move: {_words(error)}"
            also = yield from self.end()
            if isinstance(error, RobotDownError) or also is not None:
                raise RobotDownError(failed if also is None else f"{failed}; {also}") from error
            raise RobotError(failed) from error

    def end(self) -> Steps[str | None]:
        """Land the robot if it has begun; return why that failed, None when it has ended."""
        if not self.begun:
            return None
        self.begun = False  # a robot that could not be ended has a fault, and is asked no more
        try:
            yield self._robot.end
        except Exception as error:  # noqa: BLE001 - a driver's mistake must not end the thread
            return f"could not be ended: {_words(error)}"
        return None

    def reconnect(self, released: Callable[[], bool]) -> Steps[None]:
        """Disconnect the robot and connect it again, so that it has not begun.

        Args:
            released: Function that returns whether the robot may still be connected; one that was
                stopped again, and whose motors may have been cut, is left as it is.

        Raises:
            RobotError: It cannot be connected.
        """
        try:
            yield self._robot.disconnect
        except RobotError as error:
            _log.warning("a robot with a fault could not be disconnected: %s", error)
        if released():
            yield self._robot.connect
            self.begun = False


def _words(error: Exception) -> str:
    if isinstance(error, RobotError):
        return str(error)
    _log.error("a driver failed unexpectedly", exc_info=error)
    return repr(error)
