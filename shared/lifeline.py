"""Ends a child process in an orderly way when the process that started it is gone."""

from __future__ import annotations

import logging
import os
import sys
import threading
from collections.abc import Callable

_log = logging.getLogger(__name__)


def when_stdin_closes(act: Callable[[], None]) -> None:
    """Call `act` from a thread once standard input ends.

    A parent that holds the other end of the pipe and dies, however it dies, closes it: so no child
    outlives it, and each still gets to leave its robot at rest.
    """

    def wait() -> None:
        try:
            while os.read(sys.stdin.fileno(), 4096):
                pass
        except OSError as error:
            # A pipe that cannot be read says as much as one that was closed: nobody holds it.
            _log.warning("standard input: %s", error)
        act()

    threading.Thread(target=wait, name="lifeline", daemon=True).start()
