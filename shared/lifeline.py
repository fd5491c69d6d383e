"""Orderly end of a child process when the process that started it is gone."""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable

_log = logging.getLogger(__name__)


def when_stdin_closes(act: Callable[[], None]) -> None:
    """Call `act` from a thread once standard input ends.

    The parent holds the other end of the pipe, which is closed when it dies, however it dies.
    Thus no child outlives its parent, and each can still bring its robot to rest.

    Args:
        act: Function that ends the process in an orderly way.
    """

    def wait() -> None:
        try:
            while os.read(sys.stdin.fileno(), 4096):
                pass
        except OSError as error:
            # A pipe that cannot be read is treated like a closed one: its other end is gone.
            _log.warning("standard input: %s", error)
        act()

    threading.Thread(target=wait, name="lifeline", daemon=True).start()
