"""Keeps a node turning through errors, and repeats requests that are not answered."""

from __future__ import annotations

import threading
from collections.abc import Callable
from contextlib import suppress
from queue import Empty, SimpleQueue
from typing import Any

FAILED_S = 0.01
"""Pause of the node's thread after an error."""


def keep_turning(
    turn: Callable[[], None], closing: threading.Event, failed: Callable[[Exception], None]
) -> None:
    """Call a function until the node closes, also after errors: without it nothing arrives.

    Args:
        turn: The function.
        closing: Event that ends this.
        failed: Function that is told of each error.
    """
    while not closing.is_set():
        try:
            turn()
        except Exception as error:  # noqa: BLE001 - reported, and the services must still answer
            failed(error)
            closing.wait(FAILED_S)


def first_answer(client: Any, request: Any, timeout_s: float, requests: int) -> Any | None:
    """Return the first answer of a service to a request; None if none comes.

    Args:
        client: Client of rclpy, whose node turns on another thread.
        request: The request.
        timeout_s: Time to wait for an answer.
        requests: How often the request is sent at most, evenly over the time.
    """
    answers: SimpleQueue[Any] = SimpleQueue()
    pending = []
    try:
        for _ in range(requests):
            future = client.call_async(request)
            pending.append(future)
            future.add_done_callback(answers.put)
            with suppress(Empty):
                return answers.get(timeout=timeout_s / requests).result()
        return None
    finally:
        for future in pending:
            client.remove_pending_request(future)
