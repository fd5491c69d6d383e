"""Interrupts of a process that must finish something before it may end: robots in motion."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Signals that end a process: Ctrl-C, the service manager, and a closed or lost terminal."""


class Interrupts:
    """Raises KeyboardInterrupt for the first signal of `ENDING`, and only announces later ones.

    A context manager for the main thread. In other threads, which are never interrupted, it does
    nothing. A signal that the process was started to ignore, as by nohup, stays ignored.
    """

    def __init__(self, announcement: str, *, held: bool = False) -> None:
        """Prepare the handlers without installing them.

        Args:
            announcement: Line printed on stderr for a person who interrupts again.
            held: True if not even the first signal raises.
        """
        self._announcement = f"{announcement}\n".encode()
        self._held = held
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        self._before = _handled_by(self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        _restore(self._before)

    def hold(self) -> None:
        """Only announce signals from now on, because the process has begun to end."""
        self._held = True

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if not self._held:
            self._held = True
            raise KeyboardInterrupt
        with suppress(OSError):  # the terminal may be gone; what is being finished is not
            # Bypass sys.stderr, which the signal may have interrupted in the middle of a line.
            os.write(sys.stderr.fileno(), self._announcement)


@contextmanager
def postponed() -> Iterator[None]:
    """Deliver signals of `ENDING` only when the block has ended; for the main thread.

    An interrupt between the start of a process and the assignment of it to a variable would leave
    a process that no code ends.
    """
    arrived = list[int]()
    before = _handled_by(lambda number, _frame: arrived.append(number))
    try:
        yield
    finally:
        _restore(before)
        for number in arrived:
            signal.raise_signal(number)


def _handled_by(handler: Callable[[int, FrameType | None], None]) -> dict[signal.Signals, Any]:
    """Install a handler for all signals of `ENDING` that are not ignored; return those before."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    before = {number: signal.getsignal(number) for number in ENDING}
    handled = {number: old for number, old in before.items() if old is not signal.SIG_IGN}
    for number in handled:
        signal.signal(number, handler)
    return handled


def _restore(handlers: dict[signal.Signals, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)
