"""The node's thread outlives errors, and requests that are lost are repeated."""

from __future__ import annotations

import threading
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from nufleet.robot_agent.drivers.ros2.calls import first_answer, keep_turning


def test_an_error_is_told_and_the_turns_go_on() -> None:
    closing = threading.Event()
    told: list[str] = []
    turns = iter([KeyError("x"), None, ValueError("y"), None])

    def turn() -> None:
        error = next(turns, None)
        if error is not None:
            raise error
        if len(told) == 2:
            closing.set()

    keep_turning(turn, closing, lambda error: told.append(repr(error)))
    assert told == ["KeyError('x')", "ValueError('y')"]


class Client:
    """A client whose service hears only some of the requests, and answers them at once."""

    def __init__(self, *heard: bool) -> None:
        self._heard = iter(heard)
        self.pending: list[Any] = []

    def call_async(self, request: str) -> Any:
        future = SimpleNamespace(result=lambda: f"did {request}")
        heard = next(self._heard)
        self.pending.append(future)

        def add_done_callback(done: Callable[[Any], None]) -> None:
            if heard:
                done(future)

        future.add_done_callback = add_done_callback
        return future

    def remove_pending_request(self, future: Any) -> None:
        self.pending.remove(future)


@pytest.mark.parametrize(
    ("heard", "answer"), [([False, False, True], "did cut"), ([False, False, False], None)]
)
def test_a_request_that_is_lost_is_repeated(heard: list[bool], answer: str | None) -> None:
    client = Client(*heard)
    assert first_answer(client, "cut", 0.03, len(heard)) == answer
    assert client.pending == []
