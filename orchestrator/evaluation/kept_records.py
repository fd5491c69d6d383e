"""Keeps the records of an evaluation as they come, and says how long the rest will take.

A record is complete when its line is.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from pathlib import Path
from types import TracebackType
from typing import TextIO

from nufleet.orchestrator.evaluation.results import FlightRecord
from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.strict import validation_errors_as

RECORDS = "flights.jsonl"
"""File in the run's folder that holds one record per line, complete up to the last flight."""


class KeptRecords:
    """A log that writes each record at once and announces what follows; a context.

    An evaluation takes hours. When it ends early, the flights until then are in the file, and a
    resumed run continues the file.
    """

    done: int
    """Number of flights that were flown."""

    def __init__(
        self,
        folder: Path,
        flights: int,
        done: int = 0,
        *,
        say: Callable[[str], None],
        on_point: Callable[[Sequence[FlightRecord]], object],
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        """Open the file, to which another target's records may have been written before.

        Args:
            folder: Folder of the run.
            flights: Number of flights that are planned.
            done: Number of those that were flown before an interruption.
            say: Callback that receives one line before the flights along each path.
            on_point: Callback that receives all records after each duration of own flying.
            clock: Time in s.
        """
        self._flights, self._say, self._on_point = flights, say, on_point
        self._clock = clock
        self._began_s, self._before, self.done = clock(), done, done
        self._file: TextIO = (folder / RECORDS).open("a", encoding="utf-8")

    def __enter__(self) -> KeptRecords:
        return self

    def __exit__(
        self, _type: type[BaseException] | None, _error: object, _trace: TracebackType | None
    ) -> None:
        self._file.close()

    def begins(self, what: str, flights: int) -> None:
        """Announce some flights, with an estimate of the time that is left."""
        left, flown = "", self.done - self._before
        if flown:
            per_flight_s = (self._clock() - self._began_s) / flown
            left = f", about {_duration(per_flight_s * (self._flights - self.done))} left"
        first, last = self.done + 1, self.done + flights
        which = f"flights {first} to {last}" if flights > 1 else f"flight {first}"
        self._say(f"[bold]{what}[/]: {which} of {self._flights}{left}")

    def flown(self, record: FlightRecord) -> None:
        """Write a record."""
        self._file.write(record.model_dump_json() + "\n")
        self._file.flush()
        self.done += 1

    def point_complete(self, records: Sequence[FlightRecord]) -> None:
        """Pass on what is known until now."""
        self._on_point(records)


def read_records(folder: Path) -> list[FlightRecord]:
    """Return the records in a run's folder; the last may have been cut off while it was written.

    Raises:
        InvalidInputError: The file cannot be read, or holds something else.
    """
    path = folder / RECORDS
    if not path.exists():
        return []
    with system_errors_as(InvalidInputError, f"{path} cannot be read"):
        text = path.read_text(encoding="utf-8")
    whole = text[: text.rfind("\n") + 1]
    if whole != text:
        with system_errors_as(InvalidInputError, f"{path} cannot be written"):
            path.write_text(whole, encoding="utf-8")
    with validation_errors_as(InvalidInputError, str(path)):
        return [FlightRecord.model_validate_json(line) for line in whole.splitlines()]


def _duration(seconds: float) -> str:
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60:02} min"
