"""One destination of a study's events: a bounded queue and the thread that empties it."""

from __future__ import annotations

import logging
import threading
import time
from collections import deque
from collections.abc import Callable, Sequence
from typing import Protocol

import numpy as np

from nufleet.orchestrator.viewer.events import IterationEvent, TakenBackEvent, ViewerEvent
from nufleet.shared.errors import NufleetError

BATCH_S = 0.25
"""Interval between writes. Writing every sample by itself would cost tens of times as much."""

WAITING_MAX = 4096
"""Limit on the number of droppable events that wait. Beyond it the oldest are dropped, since a
viewer needs the newest most."""

WAITING_BYTES_MAX = 64 * 2**20
"""Limit on the size of the arrays in all droppable events that wait."""

log = logging.getLogger(__name__)


class Sink(Protocol):
    """A destination of events, used by one thread only. Calls may block for any length of time."""

    def write(self, events: Sequence[ViewerEvent]) -> None:
        """Write events, oldest first."""

    def close(self) -> None:
        """Write out everything and release the destination."""


class Outlet:
    """Accepts events without ever waiting and writes them to a sink from its own thread.

    When the sink is slow, telemetry and messages are dropped, oldest first, and counted; iterations
    and the guard's events stay queued. When the sink has failed, all events are dropped and
    counted.
    """

    def __init__(
        self,
        name: str,
        open_sink: Callable[[], Sink],
        *,
        waiting_max: int = WAITING_MAX,
        waiting_bytes_max: int = WAITING_BYTES_MAX,
    ) -> None:
        self.name = name
        self._open_sink = open_sink
        self._waiting_max = waiting_max
        self._waiting_bytes_max = waiting_bytes_max
        self._waiting_bytes = 0
        self._changed = threading.Condition()
        self._kept: deque[tuple[int, ViewerEvent]] = deque()
        self._droppable: deque[tuple[int, ViewerEvent]] = deque()
        self._taken = 0
        self._dropped = 0
        self._closing = False
        self._dead = False
        self._opened = threading.Event()
        self._open_error: Exception | None = None
        # A daemon thread, since one that is stuck in a sink must not keep the process alive.
        self._thread = threading.Thread(target=self._run, name=f"viewer-{name}", daemon=True)

    @property
    def dropped(self) -> int:
        """Number of events that were not written."""
        with self._changed:
            return self._dropped

    def start(self) -> None:
        """Start the thread, which opens the sink."""
        self._thread.start()

    def wait_opened(self, timeout_s: float) -> None:
        """Wait until the sink is open.

        Raises:
            TimeoutError: The sink did not open in time.
            Exception: Any error that opening the sink raised.
        """
        if not self._opened.wait(timeout_s):
            raise TimeoutError(f"{self.name} did not open within {timeout_s:g} s")
        if self._open_error is not None:
            raise self._open_error

    def offer(self, event: ViewerEvent) -> None:
        """Accept an event, without waiting for the sink."""
        with self._changed:
            if self._dead or self._closing:
                self._dropped += 1
                return
            self._taken += 1
            if isinstance(event, IterationEvent | TakenBackEvent):
                self._kept.append((self._taken, event))
                return
            self._droppable.append((self._taken, event))
            self._waiting_bytes += _array_bytes(event)
            while (
                len(self._droppable) > self._waiting_max
                or self._waiting_bytes > self._waiting_bytes_max
            ):
                self._waiting_bytes -= _array_bytes(self._droppable.popleft()[1])
                self._dropped += 1

    def ask_to_close(self) -> None:
        """Accept no more events, and have the thread end after writing those that are queued."""
        with self._changed:
            self._closing = True
            self._changed.notify()

    def join(self, timeout_s: float) -> bool:
        """Wait for the thread to end; returns False when it is still stuck in its sink."""
        if self._thread.ident is None:
            return True
        self._thread.join(max(0.0, timeout_s))
        return not self._thread.is_alive()

    def _run(self) -> None:
        try:
            sink = self._open_sink()
        except Exception as error:  # noqa: BLE001 - raised again in wait_opened
            self._open_error = error
            self._die(0)
            self._opened.set()
            return
        self._opened.set()
        in_hand = 0
        try:
            while (events := self._take()) is not None:
                in_hand = len(events)
                sink.write(events)
                in_hand = 0
            sink.close()
        except NufleetError as error:
            log.warning("the viewer's %s failed: %s; the study continues", self.name, error)
        except Exception:
            log.exception("the viewer's %s failed; the study continues", self.name)
        finally:
            self._die(in_hand)

    def _take(self) -> list[ViewerEvent] | None:
        """Wait for the next batch of events; returns None when closing and nothing is left."""
        with self._changed:
            deadline = time.monotonic() + BATCH_S
            while not self._closing and (left := deadline - time.monotonic()) > 0:
                self._changed.wait(left)
            batch = sorted((*self._kept, *self._droppable), key=lambda entry: entry[0])
            self._forget_waiting()
            if not batch and self._closing:
                return None
        return [event for _, event in batch]

    def _die(self, in_hand: int) -> None:
        with self._changed:
            self._dead = True
            self._dropped += in_hand + len(self._kept) + len(self._droppable)
            self._forget_waiting()

    def _forget_waiting(self) -> None:
        self._kept.clear()
        self._droppable.clear()
        self._waiting_bytes = 0


def _array_bytes(event: ViewerEvent) -> int:
    return sum(value.nbytes for value in vars(event).values() if isinstance(value, np.ndarray))
