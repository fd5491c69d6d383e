"""Routers that are linked: what Zenoh forgets when a link breaks and is back at once, and the cure.

A Zenoh router (1.10) tells the routers beside it what is declared at its clients when the tree of
routers changes. It looks at the tree 0.1 s after an event, and sees no change if the link to a
router broke and was back before: then neither tells the other anything that was declared already,
for as long as the link holds. Zenoh links again within milliseconds.
"""

from __future__ import annotations

import logging
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager

from nufleet.shared.wire.session import Session

LOOK_EVERY_S = 1.0
"""Time between two looks at the links of a router."""

DEAF_WHEN_LINKING_S = 5.0
"""How long a router that links with others hears nothing of one before it opens again.

New links are silent for some tenths of a second.
"""

DEAF_WHEN_LINKED_S = 10.0
"""The same of a router that only others link with.

They are to open again first, since fewer programs depend on them.
"""

TREE_PAUSE_S = 0.5
"""Time for which a router is away when it opens again, in which the others miss it for certain."""

_log = logging.getLogger(__name__)

OpenRouter = Callable[[list[str]], AbstractContextManager[Session]]
"""Opens a router that listens on some endpoints."""


def route(
    opening: OpenRouter,
    listen: list[str],
    ended: threading.Event,
    opened: Callable[[list[str]], None],
    *,
    links: bool,
) -> None:
    """Keep a router open until an event, and open it again when it is deaf to one it is linked to.

    Programs connected to it lose their connection for about a second when it opens again, as they
    do when a router restarts. It does so only once where no other answers then either, as the
    settings of a router may forbid it to answer.

    Args:
        opening: Opens the router.
        listen: Endpoints to listen on.
        ended: Event that ends it.
        opened: Called with the endpoints that it listens on, each time it is open.
        links: Whether it links with others, rather than only others with it.

    Raises:
        EndpointInUseError: The router cannot listen on an endpoint.
    """
    hearing = _Hearing(DEAF_WHEN_LINKING_S if links else DEAF_WHEN_LINKED_S)
    while True:
        with opening(listen) as session:
            endpoints = session.listening_on()
            opened(endpoints)
            if any(endpoint.endswith(":0") for endpoint in listen):
                listen = endpoints
            while not ended.wait(LOOK_EVERY_S):
                if hearing.lost({router: session.hears(router) for router in session.linked_to()}):
                    break
            else:
                return
        _log.warning(
            "a link to another router broke and was back at once, and since then this router hears "
            "nothing of what is behind it: it closes and opens again"
        )
        ended.wait(TREE_PAUSE_S)


class _Hearing:
    """Since when a router hears nothing of which router beside it."""

    def __init__(self, patience_s: float) -> None:
        self._patience_s = patience_s
        self._in_vain = False
        self._silent_since_s = dict[str, float]()

    def lost(self, heard: dict[str, bool | None]) -> bool:
        """Return whether one was silent for too long, from what was heard of each just now."""
        self._in_vain = self._in_vain and True not in heard.values()
        now_s = time.monotonic()
        self._silent_since_s = {
            router: self._silent_since_s.get(router, now_s)
            for router, hears in heard.items()
            if hears is False
        }
        if (
            self._in_vain
            or now_s - min(self._silent_since_s.values(), default=now_s) < self._patience_s
        ):
            return False
        self._silent_since_s.clear()
        self._in_vain = True  # until one answers
        return True
