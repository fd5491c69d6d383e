"""A virtual clock and the jobs scheduled on it; all random numbers come from one seed."""

from __future__ import annotations

import heapq
import random
from collections.abc import Callable

Job = Callable[[], None]


class World:
    """Runs jobs in the order of their times, and those at the same time in the order given.

    `now_s` is the virtual time, `events` the number of jobs run until then.
    """

    def __init__(self, seed: int) -> None:
        self.now_s = 0.0
        self.random = random.Random(seed)  # noqa: S311 - a schedule is no secret
        self.events = 0
        self._given = 0
        self._jobs: list[tuple[float, int, Job]] = []

    def at(self, time_s: float, job: Job) -> None:
        """Schedule a job for a time, or for now if that time has passed."""
        self._given += 1
        heapq.heappush(self._jobs, (max(time_s, self.now_s), self._given, job))

    def after(self, delay_s: float, job: Job) -> None:
        """Schedule a job for `delay_s` seconds from now."""
        self.at(self.now_s + delay_s, job)

    def between(self, low: float, high: float) -> float:
        """Draw a number uniformly from [low, high)."""
        return low + (high - low) * self.random.random()

    def run(self, until_s: float, done: Callable[[], bool]) -> None:
        """Run jobs until a time has come, `done` returns True, or no job is left."""
        jobs = self._jobs
        while jobs and not done():
            time_s, _, job = heapq.heappop(jobs)
            if time_s > until_s:
                return
            self.now_s = time_s
            self.events += 1
            job()
