"""Simulates the protocol for many seeds, and shows the shortest story that breaks an invariant."""

from __future__ import annotations

import gc
import logging
import multiprocessing
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from benchmarks.faults.figure import Figure
from benchmarks.faults.simulation.schedule import drawn
from benchmarks.faults.simulation.simulation import shortened, story, violation
from benchmarks.faults.simulation.without import without as taken_out

_SEEDS_AT_ONCE = 250
_COLLECTED_EVERY = 25
_SHOWN_VIOLATIONS = 5
_LINE_EVERY_S = 60.0


@dataclass(frozen=True)
class Found:
    """What came of some seeds: how many, and which of them broke what."""

    seeds: int
    violations: tuple[tuple[int, str], ...]


def figures(
    seeds: int, *, first: int = 0, processes: int | None = None, without: str | None = None
) -> list[Figure]:
    """Simulate seeds `first` to `first + seeds`, with a line of progress on stderr.

    Args:
        seeds: how many schedules.
        first: the first seed.
        processes: how many work at the same time.
        without: a fix that is taken out, see `benchmarks.faults.simulation.without`.
    """
    began_s = time.perf_counter()
    done, violations = 0, list[tuple[int, str]]()
    progress = _Progress()
    try:
        for found in _simulated(seeds, first, processes or 1, without):
            done += found.seeds
            for seed, broken in found.violations:
                print(f"seed {seed}: {broken}", flush=True)
            violations += found.violations
            rate = done / (time.perf_counter() - began_s)
            progress.show(
                f"{done} of {seeds} schedules from seed {first} on, {len(violations)} violations, "
                f"{rate:.0f} a second"
            )
            if without is not None and violations:
                break  # it is found
    except KeyboardInterrupt:
        print(f"interrupted after {done} of {seeds} schedules")
    progress.end()
    for seed, broken in sorted(violations)[:_SHOWN_VIOLATIONS]:
        _show(seed, broken, without)
    hours = (time.perf_counter() - began_s) / 3600
    # Taken out, a fix is to be missed.
    allowed = 0 if without is None else None
    return [
        Figure("schedules simulated", done, ""),
        Figure("schedules an hour", done / hours, ""),
        Figure("schedules that break an invariant", len(violations), "", limit=allowed),
    ]


def _simulated(seeds: int, first: int, processes: int, without: str | None) -> Iterator[Found]:
    blocks = [
        (start, min(start + _SEEDS_AT_ONCE, first + seeds), without)
        for start in range(first, first + seeds, _SEEDS_AT_ONCE)
    ]
    if processes == 1:
        yield from map(_block, blocks)
        return
    with multiprocessing.get_context("spawn").Pool(processes) as pool:
        yield from pool.imap(_block, blocks)


def _block(block: tuple[int, int, str | None]) -> Found:
    first, end, without = block
    broken = list[tuple[int, str]]()
    with _undisturbed(), taken_out(without):
        for seed in range(first, end):
            why = violation(drawn(seed))
            if why is not None:
                broken.append((seed, why))
            if seed % _COLLECTED_EVERY == 0:
                gc.collect()
    return Found(end - first, tuple(broken))


@contextmanager
def _undisturbed() -> Iterator[None]:
    """Log nothing and collect no garbage by itself, in this process and in here alone."""
    disabled, collects = logging.root.manager.disable, gc.isenabled()
    logging.disable(logging.CRITICAL)  # what goes wrong is meant to
    gc.disable()  # collecting among the objects of one schedule takes a sixth of the time
    gc.collect()
    gc.freeze()  # and looking through those of all imported modules takes another one
    try:
        yield
    finally:
        gc.unfreeze()
        if collects:
            gc.enable()
        logging.disable(disabled)


def _show(seed: int, broken: str, without: str | None) -> None:
    """Print the shortest schedule that breaks an invariant as this seed does, as a story."""
    option = "" if without is None else f" --without {without}"
    print(f"seed {seed}, shortened: {broken}")
    print(f"  again: python -m benchmarks.faults simulate --seeds 1 --first {seed}{option}")
    with taken_out(without):
        short = shortened(drawn(seed))
        for line in (*map(str, short.faults), *story(short)):
            print(f"  {line}")


class _Progress:
    """One line that changes on a terminal; elsewhere a line a minute."""

    def __init__(self) -> None:
        self._terminal = sys.stderr.isatty()
        self._shown_s = time.monotonic()

    def show(self, line: str) -> None:
        """Say how far it is."""
        if self._terminal:
            print(f"\r\x1b[K{line}", end="", file=sys.stderr, flush=True)
        elif time.monotonic() > self._shown_s + _LINE_EVERY_S:
            self._shown_s = time.monotonic()
            print(line, file=sys.stderr, flush=True)

    def end(self) -> None:
        """Leave the terminal's line free."""
        if self._terminal:
            print("\r\x1b[K", end="", file=sys.stderr, flush=True)
