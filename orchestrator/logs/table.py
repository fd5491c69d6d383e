"""Tables as logs: text files whose first line names the columns, cfclient's among them."""

from __future__ import annotations

import csv
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from nufleet.orchestrator.logs.signals import Channel, LogError, Samples, Signal, unknown_signal

LINE_MAX = 100_000
"""Longest line, in characters; a file of another kind may have no line ends at all."""

_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_TIME_NAMES = ("t", "time", *(f"{name}_{unit}" for name in ("t", "time") for unit in _UNITS))
_DECIMAL_COMMA = re.compile(r"^\s*[-+]?\d+,\d+([eE][-+]?\d+)?\s*$")


def channels(path: Path) -> tuple[Channel, ...]:
    """Return the columns of a table."""
    with _opened(path) as (header, _, _):
        return tuple(Channel(name=name, samples=None) for name in header)


def read(path: Path, names: Sequence[str], time: str | None) -> dict[str, Signal]:
    """Read columns of a table.

    Semicolons and tabs separate columns as well as commas do, whichever the first line holds; where
    semicolons or tabs do, numbers may have decimal commas.

    Args:
        path: File to read.
        names: Names of the columns.
        time: Name of the column of times, followed by `:` and its unit unless it ends with the
            unit; None takes the one that is called `t`, `time`, `time_s` and the like.

    Returns:
        One signal for each name; rows in which its cell is empty are left out.

    Raises:
        LogError: The file is no such table, or lacks a column; the message names the line.
    """
    with _opened(path) as (header, rows, separator):
        for name in names:
            if name not in header:
                raise unknown_signal(path, name, header)
        clock, unit = _time_column(path, header, time)
        places = {name: header.index(name) for name in names}
        found = {name: Samples(path, name) for name in names}
        for number, row in rows:
            if not any(cell.strip() for cell in row):
                continue
            if len(row) != len(header):
                raise LogError(
                    f"{path}, line {number}: {len(row)} columns, and the first line names "
                    f"{len(header)}"
                    + (
                        "; numbers with decimal commas need semicolons between columns"
                        * (separator == "," and len(row) > len(header))
                    )
                )
            at_s = _number(path, number, row[header.index(clock)], separator) * unit
            for name, place in places.items():
                if row[place].strip():
                    found[name].add(at_s, _number(path, number, row[place], separator))
    return {name: samples.signal() for name, samples in found.items()}


@contextmanager
def _opened(path: Path) -> Iterator[tuple[list[str], Iterator[tuple[int, list[str]]], str]]:
    """Yield the header, the numbered rows below it, and the character between columns."""
    try:
        with path.open(encoding="utf-8-sig", newline="") as file:
            first = _line(file, path)
            separator = max(";\t,", key=first.count)
            header = [name.strip().strip("\"'") for name in first.split(separator)]
            if len(header) < 2 or any(not name or _is_number(name) for name in header):
                raise LogError(
                    f"{path}: the first line must name the columns, separated by commas, "
                    f"semicolons or tabs; it is {first.strip()!r:.120}"
                )
            twice = sorted({name for name in header if header.count(name) > 1})
            if twice:
                raise LogError(f"{path}: the first line names {', '.join(twice)} twice")
            lines = iter(lambda: _line(file, path), "")
            rows = enumerate(csv.reader(lines, delimiter=separator), start=2)
            yield header, rows, separator
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise LogError(f"{path}: not a table of text: {error}") from error


def _line(file: TextIO, path: Path) -> str:
    line = file.readline(LINE_MAX)
    if len(line) == LINE_MAX:
        raise LogError(f"{path}: a line is longer than {LINE_MAX} characters: this is no table")
    return line


def _time_column(path: Path, header: Sequence[str], wanted: str | None) -> tuple[str, float]:
    """Return the name of the column of times, and the length of its unit in s."""
    if wanted is None:
        found = [name for name in header if name.lower() in _TIME_NAMES]
        if len(found) != 1:
            raise LogError(
                f"{path}: which column holds the times, and in which unit? Name it with --time, as "
                f"in --time {header[0]}:ms; the columns are {', '.join(header)[:400]}"
            )
        wanted = found[0]
    name, _, unit = wanted.rpartition(":") if wanted not in header else (wanted, "", "")
    if not name:
        name, unit = wanted, ""
    if name not in header:
        raise unknown_signal(path, name, header)
    if not unit:
        ending = name.rpartition("_")[2].lower()
        plain = name.lower() in ("t", "time")
        unit = "s" if plain else ending if "_" in name else ""
    if unit not in _UNITS:
        raise LogError(
            f"{path}: in which unit are the times of column {name}? Write --time {name}:UNIT with "
            f"one of {', '.join(_UNITS)}"
        )
    return name, _UNITS[unit]


def _number(path: Path, line: int, cell: str, separator: str) -> float:
    text = cell.strip()
    if separator != "," and _DECIMAL_COMMA.match(text):
        text = text.replace(",", ".")
    try:
        return float(text)
    except ValueError as error:
        raise LogError(f"{path}, line {line}: expected a number, got {cell!r:.60}") from error


def _is_number(text: str) -> bool:
    try:
        float(text.replace(",", "."))
    except ValueError:
        return False
    return True
