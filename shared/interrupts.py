"""Interrupts of a process that must finish something before it may end: robots in motion."""

from __future__ import annotations

import os
import signal
import sys
import threading
from contextlib import suppress
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
        """Only announce signals from now on, because the process has begun to end."""
        self._held = True

    def _on_signal(self, _number: int, _frame: FrameType | None) -> None:
        if not self._held:
            self._held = True
            raise KeyboardInterrupt
        with suppress(OSError):  # the terminal may be gone; what is being finished is not
            # Bypass sys.stderr, which the signal may have interrupted in the middle of a line.
            os.write(sys.stderr.fileno(), self._announcement)
