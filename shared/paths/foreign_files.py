"""Reading of drawings made by other programs: any two columns of numbers, or an SVG."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing, text_of
from nufleet.shared.paths.trajectories import POINTS_MAX, check_path

_BETWEEN = re.compile(r"[,;\s]+")
_NAMES = {"x": 0, "x_m": 0, "y": 1, "y_m": 1}


def import_points(path: Path) -> FloatArray:
    """Return the points of a file, shape (n, 2), in the file's own unit.

    An SVG is read by `read_drawing`. Any other file is read as a table of numbers separated by
    commas, semicolons, tabs or spaces, with two columns or with columns that the first line names x
    and y.

    Args:
        path: File to read.

    Raises:
        InvalidInputError: the file is neither; the message names the file, the line and the
            expected contents.
    """
    if path.suffix.lower() == ".svg":
        return read_drawing(path)
    text = text_of(path, "; expected a table of x and y, or an SVG file")
    points = np.array(_rows(text, str(path)), dtype=np.float64).reshape(-1, 2)
    check_path(points, str(path))
    return points


def _rows(text: str, name: str) -> list[tuple[float, float]]:
    columns: tuple[int, int] | None = None
    rows: list[tuple[float, float]] = []
    for number, line in enumerate(text.splitlines(), start=1):
        cells = _BETWEEN.split(line.strip().strip(",;"))
        if cells == [""] or line.lstrip().startswith("#"):
            continue
        if columns is None:
            columns, is_header = _columns(cells, f"{name}, line {number}")
            if is_header:
                continue
        try:
            rows.append((float(cells[columns[0]]), float(cells[columns[1]])))
        except (ValueError, IndexError) as error:
            raise InvalidInputError(
                f"{name}, line {number}: expected numbers for x and y, got {line!r:.80}"
            ) from error
        if len(rows) > POINTS_MAX:
            raise InvalidInputError(f"{name}: more than {POINTS_MAX} points")
    return rows


def _columns(cells: list[str], where: str) -> tuple[tuple[int, int], bool]:
    """Return the indices of the columns x and y, and True if this first line is a header."""
    names = [cell.strip("\"'").lower() for cell in cells]
    found: dict[int, int] = {}
    for place, cell in enumerate(names):
        if cell in _NAMES:
            found.setdefault(_NAMES[cell], place)
    if len(found) == 2:
        return (found[0], found[1]), True
    if len(cells) == 2:
        return (0, 1), not _is_number(names[0])
    raise InvalidInputError(
        f"{where}: {len(cells)} columns; add a first line that names two of them x and y"
    )


def _is_number(cell: str) -> bool:
    try:
        float(cell)
    except ValueError:
        return False
    return True
