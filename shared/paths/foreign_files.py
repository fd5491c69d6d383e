"""Reading of drawings made by other programs: tables as spreadsheets save them, or an SVG."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing, text_of
from nufleet.shared.paths.trajectories import POINTS_MAX, check_path

_UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001}
_HEADING = re.compile(rf"([xy])(?:[\s_/]*[\[(]?({'|'.join(_UNITS)})[\])]?)?")
"""Heading of a column that is read, such as `x`, `x_m`, `x [mm]`, `x (cm)` or `x/m`."""
_DECIMAL_COMMAS = re.compile(
    r"[+-]?\d*,?\d*(e[+-]?\d+)?(\s+[+-]?\d*,?\d*(e[+-]?\d+)?)+", re.IGNORECASE
)
"""Numbers with decimal commas between which there is only white space."""


def import_points(path: Path) -> FloatArray:
    """Return the points of a file, shape (n, 2), in m or, without any unit, in the file's own.

    An SVG is read by `read_drawing`. Any other file is read as a table. Its first line decides what
    separates the columns of the whole file: semicolons, tabs, commas or spaces, the first of these
    that it contains. A comma that separates nothing is a decimal comma. The table has two columns,
    or a first line that names the columns x and y, possibly with their unit: `x [mm]`.

    Args:
        path: File to read.

    Raises:
        InvalidInputError: the file is neither; the message names the file, the line and the
            expected contents.
    """
    if path.suffix.lower() == ".svg":
        return read_drawing(path)
    text = text_of(path, "; expected a table of x and y, or an SVG file")
    points = _Table(str(path)).points(text)
    check_path(points, str(path))
    return points


class _Table:
    """What is known of a table from the lines that were read."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._separator: str | None = None
        self._marks: set[str] = set()
        """Decimal marks, a comma or a point, that numbers of the table contain."""

    def points(self, text: str) -> FloatArray:
        """Return the numbers of x and y, shape (n, 2)."""
        rows: list[list[float]] = []
        columns, units, width = [0, 1], [1.0, 1.0], 0
        for number, line in enumerate(text.splitlines(), start=1):
            if not line.strip(" \t,;") or line.lstrip().startswith("#"):
                continue
            where = f"{self._name}, line {number}"
            if not width:
                self._separator = _separator(line)
                cells = self._cells(line)
                width = len(cells)
                named = _named_columns(cells)
                if named is not None:
                    columns, units = named
                    continue
                if width != 2:
                    raise InvalidInputError(
                        f"{where}: {width} columns; add a first line that names two of them x and y"
                    )
                if any(self._number(cell) is None for cell in cells):
                    continue
            cells = self._cells(line)
            found = [self._number(cells[k]) if k < len(cells) else None for k in columns]
            if len(cells) > width or None in found:
                raise InvalidInputError(
                    f"{where}: {self._expected(len(cells), width)}, got {line!r:.80}"
                )
            if len(self._marks) > 1:
                raise InvalidInputError(
                    f"{where}: some numbers have a decimal comma and others a decimal point; use "
                    "one of them throughout"
                )
            rows.append([unit * x for unit, x in zip(units, found, strict=True) if x is not None])
            if len(rows) > POINTS_MAX:
                raise InvalidInputError(f"{self._name}: more than {POINTS_MAX} points")
        return np.array(rows, dtype=np.float64).reshape(-1, 2)

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
