"""What the threads of this process do at each moment, as the scheduler of Linux records it.

A thread runs, is ready and waits for a processor, or is blocked: asleep, or waiting for a lock, for
Python's interpreter or for a device. Linux's perf events report every change. To read them needs
root, or CAP_PERFMON and CAP_SYS_ADMIN.
"""

from __future__ import annotations

import ctypes
import heapq
import mmap
import os
import struct
import subprocess
import threading
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from enum import Enum
from typing import Self

PAGES = 64
"""Size of a ring of records; changes of one process's threads fill it in minutes."""

_PERF_EVENT_OPEN, _CLOSE_ON_EXEC = 298, 8
_SET_FILTER = 0x40082406
_SOFTWARE, _TRACEPOINT, _DUMMY = 1, 2, 9
_THREAD, _TIME, _RAW = 1 << 1, 1 << 2, 1 << 10
_INHERIT, _SAMPLE_ID, _CLOCK, _SWITCHES, _THREADS_ALONE = 1 << 1, 1 << 18, 1 << 25, 1 << 26, 1 << 35
_LOST, _SAMPLE, _SWITCH = 2, 9, 14
_OUT, _STAYS_READY = 1 << 13, 1 << 14
_WOKEN = 28 + 24
"""Offset of the thread that is woken in a record of `sched_waking`."""

_ID = "mount -t tracefs none /sys/kernel/tracing && cat /sys/kernel/tracing/events/sched/{}/id"


class State(Enum):
    """What a thread does."""

    RUNNING = "running"
    READY = "ready"
    BLOCKED = "blocked"


@dataclass(frozen=True, order=True)
class Change:
    """A thread begins to do something else."""

    at_s: float
    """When, on the monotonic clock."""
    thread: int
    """Its id."""
    state: State | None = field(compare=False)
    """What it does from then on; None if it is woken, and so ready if it was blocked."""


class Timeline:
    """States of threads; one that has not changed yet counts as blocked."""

    def __init__(self) -> None:
        self.states: dict[int, State] = {}
        """What each thread does at the time up to which the timeline was read."""
        self._ahead: list[Change] = []

    def take(self, changes: Iterable[Change]) -> None:
        """Take changes, in any order, of which none lies before the time that was read up to."""
        for change in changes:
            heapq.heappush(self._ahead, change)

    def read(self, begins_s: float, ends_s: float) -> Iterator[tuple[float, float]]:
        """Yield spans of time in which no state changes, and apply the changes between them.

        Args:
            begins_s: Time from which on spans are yielded; changes before are applied.
            ends_s: Time up to which they are.
        """
        at_s = begins_s
        while self._ahead and self._ahead[0].at_s <= ends_s:
            change = heapq.heappop(self._ahead)
            if change.at_s > at_s:
                yield at_s, change.at_s
                at_s = change.at_s
            if change.state is not None:
                self.states[change.thread] = change.state
            elif self.states.get(change.thread, State.BLOCKED) is State.BLOCKED:
                self.states[change.thread] = State.READY
        if ends_s > at_s:
            yield at_s, ends_s


class _Ring:
    """Records of one event on one processor."""

    def __init__(self, attributes: bytes, thread: int, processor: int) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        self.handle = libc.syscall(
            _PERF_EVENT_OPEN, attributes, thread, processor, -1, _CLOSE_ON_EXEC
        )
        if self.handle < 0:
            raise OSError(ctypes.get_errno(), "perf_event_open")
        self._size = PAGES * mmap.PAGESIZE
        self._memory = mmap.mmap(self.handle, self._size + mmap.PAGESIZE)

    def records(self) -> Iterator[tuple[int, int, bytes]]:
        """Yield type, flags and bytes of the records since the last call."""
        head, tail = struct.unpack_from("=QQ", self._memory, 1024)
        while tail < head:
            kind, flags, size = struct.unpack("=IHH", self._bytes(tail, 8))
            yield kind, flags, self._bytes(tail, size)
            tail += size
        struct.pack_into("=Q", self._memory, 1032, tail)

    def close(self) -> None:
        """Record nothing more."""
        self._memory.close()
        os.close(self.handle)

    def _bytes(self, at: int, size: int) -> bytes:
        begins = at % self._size
        first = self._memory[
            mmap.PAGESIZE + begins : mmap.PAGESIZE + min(begins + size, self._size)
        ]
        return first + self._memory[mmap.PAGESIZE : mmap.PAGESIZE + size - len(first)]


class Scheduler:
    """Reports the changes of this thread, and of all threads that are started from it."""

    def __enter__(self) -> Self:
        flags = _INHERIT | _SAMPLE_ID | _SWITCHES | _THREADS_ALONE
        switches = _attributes(_SOFTWARE, _DUMMY, 0, _THREAD | _TIME, flags)
        self._rings = [_Ring(switches, 0, one) for one in sorted(os.sched_getaffinity(0))]
        self.lost = 0
        """Number of times at which records were lost, since a ring was full."""
        return self

    def __exit__(self, *_: object) -> None:
        for ring in self._rings:
            ring.close()

    def follow(self) -> None:
        """Report from now on, too, when one of the present threads of this process is woken."""
        asked = ["unshare", "--mount", "sh", "-c", _ID.format("sched_waking")]
        number = int(subprocess.run(asked, check=True, capture_output=True).stdout)
        waking = _attributes(_TRACEPOINT, number, 1, _THREAD | _TIME | _RAW, 0)
        tasks = "||".join(f"pid=={thread.native_id}" for thread in threading.enumerate())
        libc = ctypes.CDLL(None, use_errno=True)
        for processor in sorted(os.sched_getaffinity(0)):
            self._rings.append(_Ring(waking, -1, processor))
            filtered = ctypes.c_char_p(tasks.encode())
            if libc.ioctl(self._rings[-1].handle, _SET_FILTER, filtered):
                raise OSError(ctypes.get_errno(), "the filter of perf events")

    def changes(self) -> Iterator[Change]:
        """Yield the changes since the last call."""
        for ring in self._rings:
            for kind, flags, record in ring.records():
                if kind == _LOST:
                    self.lost += 1
                    continue
                thread, time_ns = struct.unpack_from("=4xIQ", record, 8)
                state = None
                if kind == _SAMPLE:
                    (thread,) = struct.unpack_from("=I", record, _WOKEN)
                elif kind == _SWITCH:
                    away = State.READY if flags & _STAYS_READY else State.BLOCKED
                    state = away if flags & _OUT else State.RUNNING
                else:
                    continue
                yield Change(1e-9 * time_ns, thread, state)


def _attributes(kind: int, config: int, period: int, sampled: int, flags: int) -> bytes:
    """Return a `perf_event_attr` whose times are of the monotonic clock."""
    attributes = bytearray(128)
    struct.pack_into(
        "=IIQQQQQ", attributes, 0, kind, 128, config, period, sampled, 0, flags | _CLOCK
    )
    struct.pack_into("=i", attributes, 92, 1)
    return bytes(attributes)
