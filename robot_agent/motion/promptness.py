"""Has the threads that move real robots run before all others, where the machine grants it.

A motion that waits for its turn on a busy machine is late by tens of milliseconds. With real-time
priority, and with memory that is never moved to a disk, it is late by a fraction of one. What other
threads of the same process compute still delays it, since Python runs one thread at a time.
"""

from __future__ import annotations

import ctypes
import logging
import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY = 10
"""Real-time priority, from 1 to 99: above everything that is not a matter of microseconds."""

_LOCK_WHAT_IS_USED = 1 | 2 | 4
"""MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT of `mlockall`: a thread's stack is locked as far as it was
used, not as far as it may grow."""

_log = logging.getLogger(__name__)


class Promptness:
    """What a process is granted for its motions; says once what it is not, and what that costs."""

    def __init__(self) -> None:
        self._locked: bool | None = None
        self._said = False

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Have the calling thread run before all others until its motion is over.

        What it computes before and after a motion may wait: it must not keep a small machine from
        answering the network.
        """
        if self._locked is None:
            self._locked = _locked()
        prioritised = _prioritised()
        self._say(prioritised, self._locked)
        try:
            yield
        finally:
            if prioritised:
                os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

    def _say(self, prioritised: bool, locked: bool) -> None:
        wanted = {"real-time priority": prioritised, "locked memory": locked}
        refused = [name for name, granted in wanted.items() if not granted]
        if refused and not self._said:
            self._said = True
            _log.warning(
                "this machine grants no %s: beside other programs, samples of the robot may be "
                "late by tens of milliseconds. Results count those that are. Grant it with "
                "LimitRTPRIO=%d and LimitMEMLOCK=infinity in the agent's service, see "
                "deploy/systemd",
                " and no ".join(refused),
                PRIORITY,
            )


def _prioritised() -> bool:
    try:
        # Threads that a driver starts from this one begin with normal priority.
        policy = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(0, policy, os.sched_param(PRIORITY))
    except OSError:
        return False
    return True


def _locked() -> bool:
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY:
        return False  # beyond its limit, a process with locked memory gets none at all
    return int(ctypes.CDLL(None).mlockall(_LOCK_WHAT_IS_USED)) == 0
