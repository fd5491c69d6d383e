"""Requests that wait at a robot are bounded in number and bytes; others are refused."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import pytest
from polling import PATIENCE_S, wait_until

from nufleet.robot_agent.network.endpoint import (
    MAX_LARGE_REQUEST_BYTES,
    MAX_WAITING_BYTES,
    Endpoint,
)
from nufleet.shared.wire.codec import Message, decode
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Done, Refusal


@dataclass
class Request:
    """A query whose payload would be copied by reading it."""

    key: str
    size_bytes: int
    is_wildcard: bool = False
    answers: list[Message] = field(default_factory=list)
    copies: int = 0

    @property
    def payload(self) -> bytes:
        self.copies += 1
        return b""

    def answer(self, payload: bytes) -> None:
        self.answers.append(decode(payload, Done, Refusal))


class Declaration:
    def withdraw(self) -> None: ...


class Session:
    def serve(self, _key_expr: str, handler: Callable[[Request], None]) -> Declaration:
        self.ask = handler
        return Declaration()


@pytest.fixture
def goes_on() -> Iterator[threading.Event]:
    goes_on = threading.Event()
    yield goes_on
    goes_on.set()


@pytest.fixture
def session(goes_on: threading.Event) -> Iterator[Session]:
    """An endpoint whose worker is stuck in the first request until it is released."""

    def slow(_principal: str, _leaf: str, _payload: bytes) -> Message:
        assert goes_on.wait(PATIENCE_S)
        return Done()

    session = Session()
    endpoint = Endpoint(
        session,  # type: ignore[arg-type]
        FleetKeys("lab"),
        "a",
        handlers={},
        commands={"goal": slow},
        urgent={},
        large=("goal",),
    )
    yield session
    goes_on.set()
    endpoint.close()


def test_large_requests_that_wait_take_no_more_memory_than_allowed(
    session: Session, goes_on: threading.Event
) -> None:
    requests = [
        Request("nufleet/lab/robot/a/by/me/goal", MAX_LARGE_REQUEST_BYTES) for _ in range(30)
    ]
    session.ask(requests[0])
    wait_until(lambda: requests[0].copies == 1)
    for request in requests[1:]:
        session.ask(request)
    refused = [request for request in requests if request.answers]
    waiting = len(requests) - len(refused) - 1
    assert waiting == MAX_WAITING_BYTES // MAX_LARGE_REQUEST_BYTES
    for request in refused:
        (answer,) = request.answers
        assert isinstance(answer, Refusal)
        assert answer.code == "overloaded"
        assert request.copies == 0
    goes_on.set()
    wait_until(lambda: all(request.answers for request in requests))
    # There is room again for what comes now.
    again = Request("nufleet/lab/robot/a/by/me/goal", MAX_LARGE_REQUEST_BYTES)
    session.ask(again)
    wait_until(lambda: again.answers == [Done()])


def test_what_is_too_large_is_refused_unread(session: Session) -> None:
    request = Request("nufleet/lab/robot/a/by/me/goal", MAX_LARGE_REQUEST_BYTES + 1)
    session.ask(request)
    (answer,) = request.answers
    assert isinstance(answer, Refusal)
    assert answer.code == "too-large"
    assert request.copies == 0
