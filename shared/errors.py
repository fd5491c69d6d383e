"""Every error that nufleet raises on purpose, and the exit code a command ends with for each.

A message says what was wrong, what was expected and what to do; it names the robot and the goal
where there is one.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import ClassVar


class NufleetError(Exception):
    """An operation that nufleet could not perform, explained to the person who requested it."""

    exit_code: ClassVar[int] = 1


class InvalidInputError(NufleetError):
    """A flag, a file or an argument that is wrong, detected before any robot moves."""

    exit_code = 2


class FleetFileError(InvalidInputError):
    """A fleet file that cannot be read: names the file, the field and what was expected."""


class TransportError(NufleetError):
    """The network did not carry a message."""


class NoRouterError(TransportError):
    """No Zenoh router answered at the endpoint."""


class EndpointInUseError(TransportError):
    """The endpoint to listen on is taken, or may not be listened on."""


class NoReplyError(TransportError):
    """A query received no reply within its time."""


class MalformedMessageError(NufleetError):
    """A payload that is not a valid message: wrong magic, version, type, field or size."""


class ProtocolVersionError(MalformedMessageError):
    """A payload written by another version of the protocol."""


class DamagedMessageError(MalformedMessageError):
    """A payload that was altered on its way; asked again, its sender sends it whole."""


class RefusedError(NufleetError):
    """A robot refused a request; `code` is meant for programs, the message for people."""

    def __init__(self, code: str, reason: str, robot: str) -> None:
        super().__init__(f"{robot} refused: {reason}")
        self.code = code
        self.reason = reason
        self.robot = robot


class RobotError(NufleetError):
    """The robot itself (driver, simulator or sensor) failed."""


class RobotDownError(RobotError):
    """The robot no longer responds to commands.

    It crashed, lost its position, or its motors were cut. It is asked for nothing else, not
    even to come to rest, until it is reconnected.
    """


class OutsideLimitsError(RobotError):
    """The robot left the limits of its measured output; it comes to rest, and then has a fault."""


class RobotLostError(NufleetError):
    """A robot that was present is no longer reachable."""


class RobotOwnedError(NufleetError):
    """Another orchestrator commands the robot."""


class StudyError(NufleetError):
    """A study that cannot continue, for example because its target is gone."""


@contextmanager
def system_errors_as(kind: type[NufleetError], what: str, advice: str = "") -> Iterator[None]:
    """Turn an OSError into an error that says what was not possible, why, and what to do.

    Args:
        kind: Type of the error.
        what: Sentence without its end that says what was not possible, and with which file.
        advice: What to do about it, from its semicolon on.
    """
    try:
        yield
    except OSError as error:
        raise kind(f"{what}: {error.strerror}{advice}") from error
