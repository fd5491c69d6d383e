"""Has a process move its real robots before all other work, where the machine grants it.

A motion that waits for its turn on a busy machine is late by tens of milliseconds. With real-time
priority, and with memory that is never moved to a disk, it is late by a fraction of one, unless
another thread of the process has Python's interpreter and itself waits for a processor. While a
robot moves, the other threads therefore run before all other programs, too, and hand the
interpreter over within half a millisecond. A process for each motion would not free it from them:
most of what it waits for are the threads of its own driver, which receive the measurements.
"""

from __future__ import annotations

import ctypes
import logging
import os
import resource
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress

PRIORITY = 10
"""Real-time priority of what moves a robot, from 1 to 99: above everything that is not a matter of
microseconds."""

OTHERS_PRIORITY = PRIORITY - 1
"""Real-time priority of the other threads of a process that moves a robot."""

SWITCH_S = 0.5e-3
"""Longest time for which a thread keeps the interpreter from one that waits for it, while a robot
moves; Python's own is 5 ms. It does not end a call that computes outside of Python."""

_LOCK_WHAT_IS_USED = 1 | 2 | 4
"""MCL_CURRENT | MCL_FUTURE | MCL_ONFAULT of `mlockall`: a thread's stack is locked as far as it was
used, not as far as it may grow."""

_FIRST = (os.SCHED_FIFO, PRIORITY)
_BEHIND = (os.SCHED_RR, OTHERS_PRIORITY)
_NORMAL = (os.SCHED_OTHER, 0)

_log = logging.getLogger(__name__)


class Promptness:
    """What a process is granted for its motions; says once what it is not, and what that costs.

    One for all robots of a process.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._moving: set[int] = set()
        self._switch_s = SWITCH_S
        self._memory_locked: bool | None = None
        self._said = False

    @contextmanager
    def motion(self) -> Iterator[None]:
        """Have the calling thread run before all others until its motion is over.

        The threads of the process that have normal priority, and those that they start meanwhile,
        run just behind it until no robot of the process moves any more. What the thread computes
        before and after a motion may wait: it must not keep a small machine from answering the
        network.
        """
        thread = threading.get_native_id()
        with self._lock:
            self._begin(thread)
        try:
            yield
        finally:
            with self._lock:
                self._end(thread)

    def _begin(self, thread: int) -> None:
        if self._memory_locked is None:
            self._memory_locked = _memory_locked()
        granted = _gave(thread, _FIRST)
        if not self._moving:
            self._switch_s = sys.getswitchinterval()
            sys.setswitchinterval(min(self._switch_s, SWITCH_S))
            if granted:
                for other in _threads_with(_NORMAL):
                    _gave(other, _BEHIND)
        self._moving.add(thread)
        self._say(granted, self._memory_locked)

    def _end(self, thread: int) -> None:
        self._moving.remove(thread)
        if thread in _threads_with(_FIRST):
            _gave(thread, _BEHIND if self._moving else _NORMAL)
        if self._moving:
            return
        sys.setswitchinterval(self._switch_s)
        # A thread that is just starting has the priority of the one that starts it, and may not
        # have been listed.
        while raised := _threads_with(_BEHIND):
            if not all(_gave(one, _NORMAL) for one in raised):
                _log.error("threads of this process cannot be given back their normal priority")
                return

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


def _threads_with(what: tuple[int, int]) -> list[int]:
    """Return the threads of this process, Python's and others, with a policy and a priority."""
    found = []
    for name in os.listdir("/proc/self/task"):  # noqa: PTH208 - names alone
        thread = int(name)
        with suppress(ProcessLookupError):  # it has ended
            policy = os.sched_getscheduler(thread) & ~os.SCHED_RESET_ON_FORK
            if (policy, os.sched_getparam(thread).sched_priority) == what:
                found.append(thread)
    return found


def _gave(thread: int, what: tuple[int, int]) -> bool:
    """Give a thread a policy and a priority; return whether this was granted, or it has ended."""
    policy, priority = what
    try:
        flag = os.sched_getscheduler(thread) & os.SCHED_RESET_ON_FORK
        if what == _FIRST:
            # Threads that a driver starts from this one begin with normal priority, not with its
            # own. Only a process with more rights may take the flag from it again.
            flag = os.SCHED_RESET_ON_FORK
        os.sched_setscheduler(thread, policy | flag, os.sched_param(priority))
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return True


def _memory_locked() -> bool:
    limit, _ = resource.getrlimit(resource.RLIMIT_MEMLOCK)
    if limit != resource.RLIM_INFINITY:
        return False  # beyond its limit, a process with locked memory gets none at all
    return int(ctypes.CDLL(None).mlockall(_LOCK_WHAT_IS_USED)) == 0
