"""Keeps the samples of a motion in time, and the switch that ends a motion early."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Outcome

GAP_MAX_S = 2.0
"""Gap between two samples that ends a paced motion: the process was frozen, or the robot hung. The
orchestrator in command will have given the motion up by then."""

CATCH_UP_MAX_S = 1.0
"""Longest delay that a paced simulation makes up for; beyond it, it keeps its pace and stays late.
What has become due meanwhile is played at once, so that robots which share a processor that is too
slow for all of them wake less often, and need less of it."""

CHUNK_SAMPLES = 256
"""Most samples that a simulation plays between two checks of the switch."""

BATCH_S = 0.2
"""Time that a paced simulation plays at once, when its references are known ahead. A robot that
wakes for every sample of 15 ms takes several times as much processor time; watched live, five
pictures per second still look like a motion."""

UNWATCHED_BATCH_S = 1.0
"""The same while no program watches. A stop does not wait for the end of a batch, since a batch is
played when its last sample is due; what a stop finds unplayed is never played."""


class HaltSwitch:
    """Set from any thread to end a motion; keeps the first outcome and reason it was given."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._thrown = threading.Event()
        self._order: tuple[Outcome, str] | None = None

    def halt(self, outcome: Outcome, reason: str) -> None:
        """Ask the motion to end.

        Args:
            outcome: Outcome to report for the motion.
            reason: Explanation for a person to read.
        """
        with self._lock:
            if self._order is None:
                self._order = (outcome, reason)
        self._thrown.set()

    @property
    def order(self) -> tuple[Outcome, str] | None:
        """Outcome and reason with which the motion is to end; None while it may continue."""
        return self._order

    def wait(self, timeout_s: float) -> None:
        """Wait for `timeout_s` seconds, or until the switch is thrown."""
        self._thrown.wait(timeout_s)


class Pace:
    """Waits for the time of each sample of one motion.

    `free` is True for a simulation that runs as fast as it can, whose samples are not timed. A real
    robot paces itself; its samples are only checked for gaps.
    """

    def __init__(
        self,
        spec: RobotSpec,
        realtime: float | None,
        switch: HaltSwitch,
        watched: Callable[[], bool] = lambda: True,
    ) -> None:
        """Prepare for one motion.

        Args:
            spec: Description of the robot.
            realtime: Multiple of real time at which a simulated robot plays; None for as fast as
                it can. Ignored for a real robot.
            switch: Switch of the motion; a gap between samples throws it.
            watched: Function that returns whether a program watches the samples.
        """
        self._watched = watched
        self.free = realtime is None and spec.simulated
        self._waits = spec.simulated
        self._period_s = spec.sample_time_s / (realtime if realtime and spec.simulated else 1.0)
        self._switch = switch
        self._due_s = self._last_s = -1.0
        self._samples = 0

    def batches(self, samples: int) -> Iterator[slice]:
        """Yield the samples of a signal that is known ahead in batches, each when it is due.

        A simulation that runs as fast as it can plays many at once, and a paced one those that have
        become due in the last `BATCH_S`, or `UNWATCHED_BATCH_S`. A real robot plays one by one.

        Args:
            samples: Length of the signal.
        """
        start = 0
        while start < samples:
            batch = slice(start, start + self.wait(samples - start))
            yield batch
            start = batch.stop

    def wait(self, most: int = 1) -> int:
        """Block until samples are due or the switch is thrown.

        Args:
            most: Number of next samples whose references are known.

        Returns:
            The number of samples to play now, from 1 to `most`.
        """
        most = min(most, CHUNK_SAMPLES)
        if self.free:
            return most
        if self._samples == 0:
            self._due_s = self._last_s = time.monotonic()
        played = 1
        if self._waits:
            if self._samples:
                batch_s = BATCH_S if self._watched() else UNWATCHED_BATCH_S
                played = max(1, min(most, round(batch_s / self._period_s)))
            last_due_s = self._due_s + (played - 1) * self._period_s
            self._switch.wait(max(0.0, last_due_s - time.monotonic()))
        now_s = time.monotonic()
        waited_s = max(self._period_s, played * self._period_s - BATCH_S)
        if now_s - self._last_s > GAP_MAX_S + waited_s:
            gap = f"nothing happened for {now_s - self._last_s:.1f} s before sample {self._samples}"
            self._switch.halt(Outcome.ABORTED, gap)
        due_s = max(self._due_s, now_s - CATCH_UP_MAX_S)
        if self._waits:
            played = min(most, max(played, 1 + int((now_s - due_s) / self._period_s)))
        self._last_s, self._due_s = now_s, due_s + played * self._period_s
        self._samples += played
        return played
