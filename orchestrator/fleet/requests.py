"""Requests to robots: one reply, or the reason why there is none."""

from __future__ import annotations

import time
from typing import TypeVar

from nufleet.shared.errors import MalformedMessageError, NoReplyError, RefusedError, RobotLostError
from nufleet.shared.wire.codec import Message, decode, encode
from nufleet.shared.wire.keys import READS, FleetKeys, principal_of
from nufleet.shared.wire.messages import DescribeRequest, Refusal
from nufleet.shared.wire.session import Session

QUERY_TIMEOUT_S = 3.0
RESULT_TIMEOUT_S = 20.0
R = TypeVar("R", bound=Message)


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
        key = self.key(robot, leaf)
        began_s = time.monotonic()
        replies = self._session.ask_all(key, encode(request), timeout_s=timeout_s)
        if not replies:
            gone = time.monotonic() - began_s < timeout_s
            if gone and self._denied(robot, leaf, request):
                raise RefusedError("not-allowed", self._why_denied(leaf), robot)
            raise NoReplyError(_no_reply(robot, leaf, request, None if gone else timeout_s))
        if len(replies) > 1:
            raise RobotLostError(
                f"{len(replies)} agents answer as {robot}: stop all but one of them"
            )
        try:
            reply = decode(replies[0], expected, Refusal)
        except MalformedMessageError as error:
            raise type(error)(
                f"robot {robot} sent an invalid reply to {leaf!r}: {error}"
            ) from error
        if isinstance(reply, Refusal):
            raise RefusedError(reply.code, reply.reason, robot)
        if not isinstance(reply, expected):
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
