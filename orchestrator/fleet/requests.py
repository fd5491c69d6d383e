"""Requests to robots: one reply, or the reason why there is none."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, TypeVar

from nufleet.shared.errors import (
    MalformedMessageError,
    NoReplyError,
    RefusedError,
    RobotLostError,
)
from nufleet.shared.wire.codec import Message, decode, encode
from nufleet.shared.wire.keys import READS, FleetKeys, principal_of
from nufleet.shared.wire.messages import DescribeRequest, Refusal
from nufleet.shared.wire.session import Session

QUERY_TIMEOUT_S = 3.0
RESULT_TIMEOUT_S = 20.0
R = TypeVar("R", bound=Message)


@dataclass(frozen=True)
class Asked(Generic[R]):
    """A question to a robot."""

    robot: str
    leaf: str
    request: Message
    expected: type[R]
    timeout_s: float


@dataclass(frozen=True)
class Reply(Generic[R]):
    """A reply that may not have arrived yet; no thread waits for it."""

    over: Callable[[], bool]
    """Returns whether there is anything more to wait for; it takes microseconds."""
    take: Callable[[], R]
    """Returns the reply once it is over, or raises what `Requests.ask` raises."""
    unsure: Callable[[], bool] = lambda: False
    """Returns whether `take` has to ask further questions, to know why there is no reply."""


class Requests:
    """Asks the robots of one fleet under the id of an orchestrator."""

    def __init__(self, session: Session, keys: FleetKeys, orchestrator_id: str) -> None:
        self._session, self._keys, self._orchestrator_id = session, keys, orchestrator_id

    def ask(
        self,
        robot: str,
        leaf: str,
        request: Message,
        expected: type[R],
        *,
        timeout_s: float = QUERY_TIMEOUT_S,
    ) -> R:
        """Return the reply of a robot to a request.

        Args:
            robot: Name of the robot.
            leaf: End of the key, below the robot's name or the sender's.
            request: Request to send.
            expected: Type of the reply.
            timeout_s: Longest wait for it.

        Raises:
            NoReplyError, RobotLostError, RefusedError, MalformedMessageError: See `Fleet`.
        """
        began_s = time.monotonic()
        question = Asked(robot, leaf, request, expected, timeout_s)
        replies = self._session.ask_all(self.key(robot, leaf), encode(request), timeout_s=timeout_s)
        return self._reply(question, replies, time.monotonic() - began_s)

    def ask_later(
        self,
        robot: str,
        leaf: str,
        request: Message,
        expected: type[R],
        *,
        timeout_s: float = QUERY_TIMEOUT_S,
    ) -> Reply[R]:
        """Ask as `ask` does, and return the reply, which has not arrived yet.

        Raises:
            TransportError: The request cannot be sent.
        """
        question = Asked(robot, leaf, request, expected, timeout_s)
        replies = self._session.ask(self.key(robot, leaf), encode(request), timeout_s=timeout_s)
        began_s = time.monotonic()

        def reply() -> R:
            return self._reply(question, replies.all(), time.monotonic() - began_s)

        def unsure() -> bool:
            return self._session.identity is not None and not replies.all()

        return Reply(replies.over, reply, unsure)

    def _reply(self, question: Asked[R], replies: list[bytes], waited_s: float) -> R:
        """Return the one valid reply, or raise what is wrong; see `ask`."""
        robot, leaf, request = question.robot, question.leaf, question.request
        if not replies:
            gone = waited_s < question.timeout_s
            if gone and self._denied(robot, leaf, request):
                raise RefusedError("not-allowed", self._why_denied(leaf), robot)
            raise NoReplyError(
                _no_reply(robot, leaf, request, None if gone else question.timeout_s)
            )
        if len(replies) > 1:
            raise RobotLostError(
                f"{len(replies)} agents answer as {robot}: stop all but one of them"
            )
        try:
            reply = decode(replies[0], question.expected, Refusal)
        except MalformedMessageError as error:
            raise type(error)(
                f"robot {robot} sent an invalid reply to {leaf!r}: {error}"
            ) from error
        if isinstance(reply, Refusal):
            raise RefusedError(reply.code, reply.reason, robot)
        if not isinstance(reply, question.expected):
            raise MalformedMessageError(
                f"robot {robot} sent an unexpected reply of type {type(reply).__name__}"
            )
        return reply

    def key(self, robot: str, leaf: str) -> str:
        """Return the key of a request, which names the sender's principal if it is a command."""
        return self._keys.request(robot, principal_of(self._orchestrator_id), leaf)

    def _denied(self, robot: str, leaf: str, request: Message) -> bool:
        """Return whether the router of a closed fleet keeps a command from a robot.

        Its answer is the same as that of a robot that is gone. A robot that answers a read, which
        every principal may ask, and then still not the command, is not gone.
        """
        if self._session.identity is None or leaf in READS:
            return False
        described = self._keys.robot(robot, READS[0])
        for key, asked in ((described, DescribeRequest()), (self.key(robot, leaf), request)):
            replies = self._session.ask_all(key, encode(asked), timeout_s=QUERY_TIMEOUT_S)
            if bool(replies) != (key == described):
                return False
        return True

    def _why_denied(self, leaf: str) -> str:
        principal = principal_of(self._orchestrator_id)
        return f"{principal} may not ask {leaf!r} in this fleet; the inventory says who may"


def _no_reply(robot: str, leaf: str, request: Message, waited_s: float | None) -> str:
    """Return the message about a missing reply; `waited_s` is None when no agent could answer."""
    goal_id = getattr(request, "goal_id", None)
    asked = repr(leaf) if goal_id is None else f"{leaf!r} about goal {goal_id}"
    if waited_s is None:
        return f"robot {robot} is not there, or disappeared while {asked} waited for its reply"
    return (
        f"robot {robot} did not answer {asked} within {waited_s:g} s; it may be cut off or frozen"
    )
