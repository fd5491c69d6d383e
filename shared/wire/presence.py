"""Which liveliness tokens a watch has reported, so that each change is reported once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable

OnPresence = Callable[[str, bool], None]
"""Takes a token's key, and whether it appeared (True) or disappeared (False)."""


class Presence:
    """Merges what a question and a watch say of the same tokens; used from several threads.

    A token that goes between the question and the beginning of the watch is told of by neither:
    it is one that the question knew and the watch has never mentioned.
    """

    def __init__(self, handler: OnPresence) -> None:
        self._handler = handler
        self._changed = threading.Condition()
        self._there: set[str] = set()
        self._mentioned: set[str] = set()
        self._settled = False

    def asked(self, keys: Iterable[str]) -> None:
        """Note what the question found."""
        for key in keys:
            self._note(key, True)

    def watched(self, key: str, alive: bool) -> None:
        """Note what the watch says."""
        with self._changed:
            self._note(key, alive)
            if not self._settled:
                self._mentioned.add(key)
                self._changed.notify_all()

    def settle(self, *, timeout_s: float) -> None:
        """Wait for the watch to mention what the question found; let go of what it does not."""
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
            self._handler(key, alive)
