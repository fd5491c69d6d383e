"""Reading of drawings made by other programs: tables as spreadsheets save them, or an SVG."""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing, text_of
from nufleet.shared.paths.trajectories import POINTS_MAX, check_path
from nufleet.shared.text import printable

_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_HEADING = re.compile(rf"([xy])(?:(?:[\s_/]|\bin\b)*[\[(]?({'|'.join(_UNITS)})[\])]?)?")
"""Heading of a column that is read, such as `x`, `x_m`, `x [mm]`, `x (cm)`, `x in mm` or `x/m`."""
_OTHER_UNIT = re.compile(r"[xy](?:\s*[\[(]\s*|\s*/\s*|\s+in\s+)(.+?)[\])]?")
"""Heading of such a column with another unit."""
_SEPARATOR_LINE = re.compile(r"sep=(.)", re.IGNORECASE)
"""First line by which a spreadsheet states what separates the columns."""
_DECIMAL_COMMAS = re.compile(
    r"[+-]?\d*,?\d*(e[+-]?\d+)?(\s+[+-]?\d*,?\d*(e[+-]?\d+)?)+", re.IGNORECASE
)
"""Numbers with decimal commas between which there is only white space."""


class ForeignDrawing(NamedTuple):
    """A drawing as another program saved it."""

    points: FloatArray
    """Points, shape (n, 2), in m or, without any unit, in the file's own."""

    ignored: tuple[str, ...]
    """Headings of the table's columns that are neither x nor y, such as a time."""


def import_drawing(path: Path) -> ForeignDrawing:
    """Return the drawing that a file holds.

    An SVG is read by `read_drawing`. Any other file is read as a table. Its first line decides what
    separates the columns of the whole file: semicolons, tabs, commas or spaces, the first of these
    that it contains. A comma that separates nothing is a decimal comma. The table has two columns,
    or a first line that names the columns x and y, possibly with their unit: `x [mm]`. A line such
    as `sep=;` before all others states the separator.

    Args:
        path: File to read.

    Raises:
        InvalidInputError: the file is neither; the message names the file, the line and the
            expected contents.
    """
    if path.suffix.lower() == ".svg":
        return ForeignDrawing(read_drawing(path), ())
    text = text_of(path, "; expected a table of x and y, or an SVG file")
    table = _Table(str(path))
    points = table.points(text)
    check_path(points, str(path))
    return ForeignDrawing(points, table.ignored)


class _Table:
    """What is known of a table from the lines that were read."""

    def __init__(self, name: str) -> None:
        self.ignored: tuple[str, ...] = ()
        """Headings of the columns that are not read."""
        self._name = name
        self._separator: str | None = None
        self._columns, self._units, self._width = [0, 1], [1.0, 1.0], 0
        self._stated = False
        """Whether a first line stated the separator."""
        self._marks: set[str] = set()
        """Decimal marks, a comma or a point, that numbers of the table contain."""

    def points(self, text: str) -> FloatArray:
        """Return the numbers of x and y, shape (n, 2)."""
        rows: list[list[float]] = []
        for number, line in enumerate(text.splitlines(), start=1):
            if not line.strip(" \t,;") or line.lstrip().startswith("#"):
                continue
            where = f"{self._name}, line {number}"
            if not self._width and self._heads(line, where):
                continue
            cells = self._cells(line)
            found = [self._number(cells[k]) if k < len(cells) else None for k in self._columns]
            if len(cells) > self._width or None in found:
                expected = self._expected(len(cells), self._width)
                raise InvalidInputError(f"{where}: {expected}, got {line!r:.80}")
            if len(self._marks) > 1:
                raise InvalidInputError(
                    f"{where}: some numbers have a decimal comma and others a decimal point; use "
                    "one of them throughout"
                )
            pairs = zip(self._units, found, strict=True)
            rows.append([unit * x for unit, x in pairs if x is not None])
            if len(rows) > POINTS_MAX:
                raise InvalidInputError(f"{self._name}: more than {POINTS_MAX} points")
        return np.array(rows, dtype=np.float64).reshape(-1, 2)

    def _heads(self, line: str, where: str) -> bool:
        """Learn the layout of the table from a first line; return whether it holds no point."""
        stated = _SEPARATOR_LINE.fullmatch(line.strip("\"' "))
        if stated is not None:
            self._separator, self._stated = stated[1], True
            return True
        if not self._stated:
            self._separator = _separator(line)
        cells = self._cells(line)
        self._width = len(cells)
        named = _named_columns(cells)
        if named is not None:
            self._columns, self._units = named
            others = (cell for place, cell in enumerate(cells) if place not in self._columns)
            self.ignored = tuple(printable(cell) for cell in others if cell)
            return True
        for cell in cells:
            unit = _OTHER_UNIT.fullmatch(cell.lower())
            if unit is not None:
                raise InvalidInputError(
                    f"{where}: the unit {unit[1]!r} is not one of {', '.join(_UNITS)}"
                )
        if self._width < 2:
            raise InvalidInputError(
                f"{where}: one column, where x and y are expected, got {line!r:.80}"
            )
        if self._width != 2:
            raise InvalidInputError(
                f"{where}: {self._width} columns; add a first line that names two of them x and y"
            )
        return any(self._number(cell) is None for cell in cells)

    def _cells(self, line: str) -> list[str]:
        """Return the cells of a line, without the empty ones at its end."""
        cells = [cell.strip().strip("\"'").strip() for cell in line.strip().split(self._separator)]
        while cells and not cells[-1]:
            cells.pop()
        return cells

    def _number(self, cell: str) -> float | None:
        if self._separator != ",":
            self._marks |= {mark for mark in ",." if mark in cell}
            cell = cell.replace(",", ".")
        try:
            return float(cell)
        except ValueError:
            return None

    def _expected(self, cells: int, width: int) -> str:
        if cells <= width:
            return "expected numbers for x and y"
        hint = "; are these decimal commas? Separate the columns by semicolons"
        return (
            f"{cells} cells in a table of {width} columns{hint if self._separator == ',' else ''}"
        )


def _separator(line: str) -> str | None:
    """Return what separates the columns of a table, by its first line; None for white space."""
    if _DECIMAL_COMMAS.fullmatch(line.strip()):
        return None
    return next((mark for mark in ";\t," if mark in line), None)


def _named_columns(cells: list[str]) -> tuple[list[int], list[float]] | None:
    """Return the indices of the columns x and y and their units in m; None if none are named so."""
    found: dict[str, tuple[int, float]] = {}
    for place, cell in enumerate(cells):
        heading = _HEADING.fullmatch(cell.lower())
        if heading is not None:
            found.setdefault(heading[1], (place, _UNITS[heading[2] or "m"]))
    if len(found) < 2:
        return None
    return [found["x"][0], found["y"][0]], [found["x"][1], found["y"][1]]
