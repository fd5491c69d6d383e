"""Bookkeeping of the liveliness tokens that a watch has reported, to report each change once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

OnPresence = Callable[[str, bool], None]
"""Handler that takes the key of a token, and True if it appeared or False if it disappeared."""


class Presence:
    """Merges the results of a query and of a watch for the same tokens; thread-safe.

    If a token disappears after the query and before the watch begins, neither reports that. Such a
    token is recognised by being in the query's result and never mentioned by the watch.
    """

    def __init__(self, handler: OnPresence) -> None:
        self._handlers = [handler]
        self._changed = threading.Condition()
        self._there: set[str] = set()
        self._mentioned: set[str] = set()
        self._settled = False

    def join(self, handler: OnPresence) -> None:
        """Report the tokens that are there to one more handler, and every change from now on."""
        with self._changed:
            self._handlers.append(handler)
            for key in sorted(self._there):
                handler(key, True)

    def leave(self, handler: OnPresence) -> bool:
        """Report nothing more to a handler; return whether any other is left."""
        with self._changed:
            self._handlers.remove(handler)
            return bool(self._handlers)

    def asked(self, keys: Iterable[str]) -> None:
        """Record the tokens that the query found alive."""
        for key in keys:
            self._note(key, True)

    def watched(self, key: str, alive: bool) -> None:
        """Record that the watch reported a token as alive or gone."""
        with self._changed:
            self._note(key, alive)
            if not self._settled:
                self._mentioned.add(key)
                self._changed.notify_all()

    def settle(self, *, timeout_s: float) -> None:
        """Wait for the watch to mention the tokens that the query found, and drop the others.

        Tokens that the watch has not mentioned within `timeout_s` are reported as gone.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._mentioned >= self._there, timeout_s)
            for key in self._there - self._mentioned:
                self._note(key, False)
            self._settled = True

    def _note(self, key: str, alive: bool) -> None:
        with self._changed:
            if alive == (key in self._there):
                return
            if alive:
                self._there.add(key)
            else:
                self._there.discard(key)
            for handler in self._handlers:
                handler(key, alive)
