"""Finds out that another agent serves the same robot: it hears that agent's heartbeats.

Two agents of one robot would both obey the same goal. Neither can tell which of them should, so
both refuse until one is silent.
"""

from __future__ import annotations

import logging
from collections.abc import Callable

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.codec import decode
from nufleet.shared.wire.messages import Refusal, RobotState

SILENCE_S = 2.5
"""An agent that was not heard for so long, five heartbeats, is gone."""

_log = logging.getLogger(__name__)


class Rivals:
    """Told every state that is published of this robot, on Zenoh's thread; asked from others."""

    def __init__(self, robot: str, boot_id: str, clock: Callable[[], float]) -> None:
        """Prepare; `boot_id` is this agent's own, `clock` returns monotonic seconds."""
        self._robot, self._boot_id, self._clock = robot, boot_id, clock
        self._heard: tuple[str, float] | None = None

    def heard(self, key: str, payload: bytes) -> None:
        """Take in a state, most of which are this agent's own."""
        try:
            state = decode(payload, RobotState)
        except MalformedMessageError as error:
            _log.warning("ignoring a malformed state on %s: %s", key, error)
            return
        if state.boot_id == self._boot_id:
            return
        if self.refusal() is None:
            _log.error("%s is served by another agent too, %s", self._robot, state.boot_id)
        self._heard = (state.boot_id, self._clock())

    def refusal(self) -> Refusal | None:
        """Return why no goal is taken now; None when no other agent is heard."""
        heard = self._heard
        if heard is None or self._clock() - heard[1] > SILENCE_S:
            return None
        return Refusal(
            code="two-agents",
            reason=f"agent process {heard[0]} serves {self._robot} too; end one of them",
        )
