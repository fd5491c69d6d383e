"""Detects another agent that serves the same robot, by receiving that agent's heartbeats.

Two agents of one robot would both obey the same goal. Neither can tell which of them should, so
both refuse goals until one of them is silent.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.codec import decode
from nufleet.shared.wire.messages import Refusal, RobotState

SILENCE_S = 2.5
"""Silence after which another agent counts as gone: five heartbeats."""

_log = logging.getLogger(__name__)


class Rivals:
    """Receives this robot's published states on Zenoh's thread; `refusal` works from any thread."""

    def __init__(self, robot: str, boot_id: str, clock: Callable[[], float]) -> None:
        """Begin with no other agent known.

        Args:
            robot: Name of the robot.
            boot_id: Id of this agent process.
            clock: Function that returns monotonic time in seconds.
        """
        self._robot, self._boot_id, self._clock = robot, boot_id, clock
        self._heard: tuple[str, float] | None = None

    def heard(self, key: str, payload: bytes) -> None:
        """Receive a state that another session published; this agent's own may be among them."""
        try:
            state = decode(payload, RobotState)
        except MalformedMessageError as error:
            _log.warning("ignoring a malformed state on %s: %s", key, error)
            return
        if state.boot_id == self._boot_id:
            return
        if self.refusal() is None:
            _log.error("another agent also serves %s: %s", self._robot, state.boot_id)
        self._heard = (state.boot_id, self._clock())

    def refusal(self) -> Refusal | None:
        """Return why no goal is taken now; None when there is no other agent."""
        heard = self._heard
        if heard is None or self._clock() - heard[1] > SILENCE_S:
            return None
        return Refusal(
            code="two-agents",
            reason=f"agent process {heard[0]} also serves {self._robot}; end one of the two",
        )
