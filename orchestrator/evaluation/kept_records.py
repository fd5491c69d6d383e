"""Keeps the records of an evaluation as they come, and says how long the rest will take."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TextIO

from nufleet.orchestrator.evaluation.results import FlightRecord

RECORDS = "flights.jsonl"
"""File in the run's folder that holds one record per line, complete up to the last flight."""


class KeptRecords:
    """A log that writes each record at once and announces each way; a context that closes the file.

    An evaluation takes hours. When it ends early, the flights until then are in the file.
    """

    def __init__(
        self,
        folder: Path,
        flights: int,
        *,
        say: Callable[[str], None],
        on_point: Callable[[Sequence[FlightRecord]], object],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the file, to which another target's records may have been written before.

        Args:
            folder: Folder of the run.
            flights: Number of flights that are planned.
            say: Callback that receives one line before each way.
            on_point: Callback that receives all records after each duration of own flying.
            clock: Time in s.
        """
        self._flights, self._say, self._on_point = flights, say, on_point
        self._clock = clock
        self._began_s: float | None = None
        self._done = 0
        self._file: TextIO = (folder / RECORDS).open("a", encoding="utf-8")

    def __enter__(self) -> KeptRecords:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: object, _trace: TracebackType | None
    ) -> None:
        self._file.close()

    def rehearsing(self, path: str, place: int, paths: int) -> None:
        """Announce what the target rehearses; flights are timed from the end of the last."""
        self._say(f"rehearses {path}: {place} of {paths}")
        self._began_s = None

    def way_begins(self, way: str, own_flight_s: float, flights: int) -> None:
        """Announce a way, with an estimate of the time that is left."""
        if self._began_s is None:
            self._began_s = self._clock()
        after = f" after {own_flight_s:.0f} s of its own flying" if own_flight_s else ""
        left = ""
        if self._done:
            per_flight_s = (self._clock() - self._began_s) / self._done
            left = f", about {_duration(per_flight_s * (self._flights - self._done))} left"
        last = self._done + flights
        self._say(
            f"[bold]{way}[/]{after}: flights {self._done + 1} to {last} of {self._flights}{left}"
        )

    def flown(self, record: FlightRecord) -> None:
        """Write a record."""
        self._file.write(record.model_dump_json() + "\n")
        self._file.flush()
        self._done += 1

    def point_complete(self, records: Sequence[FlightRecord]) -> None:
        """Pass on what is known until now."""
        self._on_point(records)


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02} min"
