"""States as they arrive: decoded, and checked to be of the robot that they stand for."""

from __future__ import annotations

import logging
from collections.abc import Iterator

from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.bundle import unbundled
from nufleet.shared.wire.codec import decode
from nufleet.shared.wire.messages import RobotState

_log = logging.getLogger(__name__)


def state_heard(robot: str, key: str, payload: bytes) -> RobotState | None:
    """Return the state of a robot; None, with a warning, if the payload is no such state.

    Args:
        robot: Name of the robot that the state stands for.
        key: Key of the message.
        payload: The encoded state.
    """
    try:
        state = decode(payload, RobotState)
    except MalformedMessageError as error:
        _log.warning("ignoring a malformed state on %s: %s", key, error)
        return None
    if state.robot != robot:
        _log.warning("ignoring a state of %s on %s", state.robot, key)
        return None
    return state


def states_heard(key: str, payload: bytes) -> Iterator[RobotState]:
    """Yield the states of several robots; those that are none are passed over with a warning.

    Args:
        key: Key of the message.
        payload: Message that robots which share a session have sent together.
    """
    try:
        for robot, frame in unbundled(payload):
            state = state_heard(robot, key, frame)
            if state is not None:
                yield state
    except MalformedMessageError as error:
        _log.warning("ignoring malformed states on %s: %s", key, error)
