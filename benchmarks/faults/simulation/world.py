"""A virtual clock and what is to happen when; everything drawn comes from one seed."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable

Job = Callable[[], None]


class World:
    """Runs jobs in the order of their times; two at the same time in the order they were given."""

    def __init__(self, seed: int) -> None:
        self.now_s = 0.0
        self.random = random.Random(seed)
        self.events = 0
        self._given = 0
        self._jobs: list[tuple[float, int, Job]] = []

    def at(self, time_s: float, job: Job) -> None:
        """Do a job at a time, or now where that has passed."""
        self._given += 1
        heapq.heappush(self._jobs, (max(time_s, self.now_s), self._given, job))

    def after(self, delay_s: float, job: Job) -> None:
        """Do a job after a while."""
        self.at(self.now_s + delay_s, job)

    def between(self, low: float, high: float) -> float:
        """Draw a number."""
        return low + (high - low) * self.random.random()

    def run(self, until_s: float, done: Callable[[], bool]) -> None:
        """Go on until a time has come, or something is done."""
        jobs = self._jobs
        while jobs and not done():
            time_s, _, job = heapq.heappop(jobs)
            if time_s > until_s:
                return
            self.now_s = time_s
            self.events += 1
            job()
