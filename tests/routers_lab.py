"""Routers of the tests that are kept open as those of `nufleet router` are."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from functools import partial

from polling import PATIENCE_S

from nufleet.shared.wire.routing import route
from nufleet.shared.wire.transport import open_router


@contextmanager
def kept_router(listen: str, *, connect: str | None = None) -> Iterator[list[list[str]]]:
    """Keep a router open, and yield the endpoints it listens on, once for each time it opened."""
    ended, is_open, opened = threading.Event(), threading.Event(), list[list[str]]()

    def said(endpoints: list[str]) -> None:
        opened.append(endpoints)
        is_open.set()

    connects = [] if connect is None else [connect]
    opening = partial(open_router, connect=connects)
    with ThreadPoolExecutor(1) as pool:
        routing = pool.submit(route, opening, [listen], ended, said, links=bool(connects))
        try:
            assert is_open.wait(PATIENCE_S)
            yield opened
        finally:
            ended.set()
        routing.result(PATIENCE_S)
