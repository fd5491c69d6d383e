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
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager

from nufleet.shared.errors import NufleetError
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

PATIENCE_GROWTH = 4.0
"""By how much longer a router waits each time that it opened again and still did not hear another.

The settings of the other one may forbid it to answer, and every opening costs programs their links.
"""

LOOK_MAX_S = 2.0
"""Longest time counted between two looks; if more has passed, the process was frozen."""

RETRY_S = 1.0
"""Interval at which a router that cannot open again tries to."""

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
    do when a router restarts. A router that still does not hear another one waits longer each time
    before it opens again for that one. Once it has been open, no error ends it: it tries again.

    Args:
        opening: Opens the router.
        listen: Endpoints to listen on.
        ended: Event that ends it.
        opened: Called with the endpoints that it listens on, each time it is open.
        links: Whether it links with others, rather than only others with it.

    Raises:
        EndpointInUseError: The router cannot listen on an endpoint.
        NufleetError: It cannot be opened for another reason, which the error names.
    """
    hearing = _Hearing(DEAF_WHEN_LINKING_S if links else DEAF_WHEN_LINKED_S)
    was_open, refused = False, ""
    while True:
        try:
            with opening(listen) as session:
                endpoints = session.listening_on()
                listen = list(_with_ports(listen, endpoints))
                was_open, refused = True, ""
                opened(endpoints)
                while not ended.wait(LOOK_EVERY_S):
                    if hearing.lost({other: session.hears(other) for other in session.linked_to()}):
                        break
                else:
                    return
        except NufleetError as error:
            if not was_open:
                raise
            if refused != str(error):
                refused = str(error)
                _log.error("this router is not open, and tries every %g s: %s", RETRY_S, refused)
            pause_s = RETRY_S
        else:
            _log.warning(
                "this router hears nothing of what is behind another one that it is linked to, as "
                "happens when their link broke and was back at once: it closes and opens again"
            )
            pause_s = TREE_PAUSE_S
        if ended.wait(pause_s):
            return


def _with_ports(listen: Sequence[str], endpoints: Sequence[str]) -> Iterator[str]:
    """Yield endpoints, those for any free port with the port that they were given."""
    for endpoint in listen:
        address, mark, settings = endpoint.partition("#")
        protocol, _, _ = address.partition("/")
        host, _, port = address.rpartition(":")
        alike = [one for one in endpoints if one.startswith(f"{protocol}/")]
        alike.sort(key=lambda one: not one.startswith(f"{host}:"))
        if port != "0" or not alike:
            yield endpoint
        else:
            given = alike[0].partition("#")[0].rpartition(":")[2]
            yield f"{host}:{given}{mark}{settings}"


class _Hearing:
    """For how long a router has heard nothing of which router beside it."""

    def __init__(self, patience_s: float) -> None:
        self._first_s = patience_s
        self._patience_s = dict[str, float]()
        self._silent_s = dict[str, float]()
        self._looked_s = time.monotonic()

    def lost(self, heard: dict[str, bool | None]) -> bool:
        """Return whether one was silent for too long, from what was heard of each just now."""
        now_s = time.monotonic()
        passed_s, self._looked_s = min(now_s - self._looked_s, LOOK_MAX_S), now_s
        self._silent_s = {
            router: self._silent_s.get(router, -passed_s) + passed_s
            for router, hears in heard.items()
            if hears is False
        }
        for router, hears in heard.items():
            if hears:
                self._patience_s.pop(router, None)
        given_up = {
            router: patience_s
            for router, silent_s in self._silent_s.items()
            if silent_s >= (patience_s := self._patience_s.get(router, self._first_s))
        }
        for router, patience_s in given_up.items():
            self._patience_s[router] = PATIENCE_GROWTH * patience_s
        if given_up:
            self._silent_s.clear()
        return bool(given_up)
