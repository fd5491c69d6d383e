"""Whether the system runs this thread, and the threads that it begins, before those of others."""

from __future__ import annotations

import os
from contextlib import suppress

FIRST = -20
USUAL = 0


def urgent(first: bool) -> None:
    """Ask the system to run this thread first, or as usual again.

    Where the machine does not grant that, as most do to none but an administrator, nothing changes.

    Args:
        first: Whether it is to run before all that is not urgent.
    """
    with suppress(PermissionError):
        os.setpriority(os.PRIO_PROCESS, 0, FIRST if first else USUAL)
