"""Requests that command a robot: attributed to their sender, and written to the audit log.

The key of a command names its principal (`by/{principal}/goal`). The router of a closed fleet lets
each principal write below its own name only, so the name is proven. The id of the sender inside the
request has to begin with that name.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from nufleet.robot_agent.journal.audit_log import AuditLog
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.robot_agent.network.endpoint import MAX_LARGE_REQUEST_BYTES, Answer, CommandHandler
from nufleet.shared.errors import RefusedError
from nufleet.shared.wire.codec import Message, decode
from nufleet.shared.wire.keys import principal_of
from nufleet.shared.wire.messages import (
    AcknowledgeRequest,
    CancelRequest,
    GoalRequest,
    InstallRequest,
    Refusal,
    ReleaseRequest,
    RemovePriorRequest,
    StopRequest,
)

Command = (
    AcknowledgeRequest
    | CancelRequest
    | GoalRequest
    | InstallRequest
    | ReleaseRequest
    | RemovePriorRequest
)
C = TypeVar("C", bound=Command)


class Commands:
    """Makes handlers that check the sender of a command and record it with its answer."""

    def __init__(self, audit: AuditLog | None) -> None:
        """Prepare to make handlers.

        Args:
            audit: Audit log of the robot; None to keep none.
        """
        self._audit = audit

    def handler(self, kind: type[C], obey: Callable[[C], Answer]) -> CommandHandler:
        """Return the handler of one kind of command.

        Args:
            kind: Type of the request.
            obey: Function that obeys the request or refuses it.
        """

        def handle(principal: str, leaf: str, payload: bytes) -> Answer:
            request = decode(payload, kind, max_bytes=MAX_LARGE_REQUEST_BYTES)
            try:
                answer = self._refusal(principal, request) or obey(request)
            except RefusedError as error:
                self._record(principal, leaf, request, _refused(error.code, error.reason))
                raise
            except JournalError as error:
                self._record(principal, leaf, request, _refused("journal", str(error)))
                raise
            self._record_when_known(principal, leaf, request, answer)
            return answer

        return handle

    def stopped(
        self, principal: str | None, request: StopRequest | None, *, answer: str = "stopped"
    ) -> None:
        """Record a stop, which every sender may give; `request` is None for a malformed one."""
        if self._audit is not None:
            sender, reason = ("", "") if request is None else (request.sender, request.reason)
            answer = "malformed, and obeyed" if request is None else answer
            what = "kill" if request is not None and request.kill else "stop"
            self._audit.record(principal, sender, what, reason, answer)

    def _refusal(self, principal: str, request: Command) -> Refusal | None:
        sender = _sender(request)
        if principal_of(sender) == principal:
            return None
        return Refusal(
            code="wrong-sender",
            reason=f"the request came from {principal} and names {sender} as its sender",
        )

    def _record_when_known(
        self, principal: str, leaf: str, request: Command, answer: Answer
    ) -> None:
        if not isinstance(answer, Future):
            self._record(principal, leaf, request, _summary(answer))
            return

        def done(future: Future[Message]) -> None:
            error = None if future.cancelled() else future.exception()
            if future.cancelled() or error is not None:
                self._record(principal, leaf, request, f"failed: {error or 'cancelled'}")
            else:
                self._record(principal, leaf, request, _summary(future.result()))

        answer.add_done_callback(done)

    def _record(self, principal: str, leaf: str, request: Command, answer: str) -> None:
        if self._audit is not None:
            epoch = None if isinstance(request, ReleaseRequest) else request.epoch
            sender, about = _sender(request), _about(request)
            self._audit.record(principal, sender, leaf, about, answer, epoch=epoch)


def _sender(request: Command) -> str:
    return request.owner if isinstance(request, GoalRequest) else request.sender


def _about(request: Command) -> str:
    match request:
        case GoalRequest() | CancelRequest():
            return request.goal_id
        case AcknowledgeRequest():
            return ", ".join(request.goal_ids)
        case InstallRequest():
            return request.sha256
        case _:
            return ""


def _summary(answer: Message) -> str:
    return _refused(answer.code, answer.reason) if isinstance(answer, Refusal) else "done"


def _refused(code: str, reason: str) -> str:
    return f"refused {code}: {reason}"
