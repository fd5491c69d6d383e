"""Interrupts of a process that has something to finish before it may end: robots in motion."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
from types import FrameType
from typing import Any

ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
"""Ctrl-C, the service manager, and a terminal that is closed or a connection to it that is lost."""


class Interrupts:
    """Raises KeyboardInterrupt for the first of these signals, and only announces any other.

    A context manager of the main thread; in any other, none of which is ever interrupted, it does
    nothing. A signal that the process was started to ignore, as nohup does it, stays ignored.
    """

    def __init__(self, announcement: str, *, held: bool = False) -> None:
        """Prepare.

        Args:
            announcement: what a person who interrupts again is told.
            held: whether not even the first signal raises.
        """
        self._announcement = f"{announcement}\n".encode()
        self._held = held
        self._before: dict[signal.Signals, Any] = {}

    def __enter__(self) -> Interrupts:
        if threading.current_thread() is threading.main_thread():
            for number in ENDING:
                before = signal.getsignal(number)
                if before is not signal.SIG_IGN:
                    self._before[number] = before
                    signal.signal(number, self._on_signal)
        return self

    def __exit__(self, *_: object) -> None:
        for number, before in self._before.items():
            signal.signal(number, before)
        self._before.clear()

    def hold(self) -> None:
        """Only announce signals from now on: the end has begun."""
        self._held = True

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if not self._held:
            self._held = True
            raise KeyboardInterrupt
        with suppress(OSError):  # the terminal may be gone; what is being finished is not
            # Past sys.stderr, which the signal may have found in the middle of a line.
            os.write(sys.stderr.fileno(), self._announcement)
