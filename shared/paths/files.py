"""Reading of drawn paths from files (CSV in metres, or an SVG), and writing as CSV."""

from __future__ import annotations

import codecs
import csv
from collections.abc import Callable
from pathlib import Path

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.paths.svg import svg_points
from nufleet.shared.paths.trajectories import check_path

FILE_BYTES_MAX = 8 * 2**20
"""Largest accepted file; a hundred thousand points with ten digits each take 3 MB."""

_CSV_COLUMNS = ["x_m", "y_m"]


def read_drawing(path: Path) -> FloatArray:
    """Return the points of a drawing, shape (n, 2), in m.

    Args:
        path: File with the ending .csv or .svg.

    Raises:
        InvalidInputError: the file cannot be read, is neither CSV nor SVG, or contains no valid
            path (a single point, NaN, too many points). The message names the file and the fault.

    Examples:
        >>> from nufleet.shared.paths.installed import find_drawing
        >>> read_drawing(find_drawing("clover")).shape
        (312, 2)
    """
    readers: dict[str, Callable[[str, str], FloatArray]] = {".csv": _csv, ".svg": svg_points}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidInputError(f"{path}: a drawing must be a .csv or .svg file")
    text = text_of(path)
    points = reader(text, str(path))
    check_path(points, str(path))
    return points


def text_of(path: Path, hint: str = "") -> str:
    """Return the text of a file that holds a drawing.

    Args:
        path: Path of the file.
        hint: Continuation of the message of an error, such as what was expected.

    Raises:
        InvalidInputError: the file cannot be read, is no text, or is too large.
    """
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise InvalidInputError(f"{path}: larger than {FILE_BYTES_MAX} bytes")
        data = path.read_bytes()
        # Spreadsheets also save tables as UTF-16: a mark of two bytes, then an ASCII character.
        wide = data.startswith(codecs.BOM_UTF16_LE) and data[3:4] == b"\0"
        return data.decode("utf-16" if wide else "utf-8-sig")
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror}{hint}") from error
    except UnicodeDecodeError as error:
        raise InvalidInputError(f"{path}: cannot be read: it is not text in UTF-8{hint}") from error


def write_drawing(path: Path, points: FloatArray) -> None:
    """Store a drawing as a CSV file for `read_drawing`, rounded to a tenth of a millimetre.

    Args:
        path: File to write, with the ending .csv.
        points: Points of the drawing in m, shape (n, 2).

    Raises:
        InvalidInputError: the points are not a path, or the file has another ending or cannot be
            written.
    """
    if path.suffix.lower() != ".csv":
        raise InvalidInputError(f"{path}: a drawing is stored as a .csv file")
    rounded = np.round(points, 4) + 0.0  # no negative zeros
    check_path(rounded, str(path))
    rows = "".join(f"{x:.4f},{y:.4f}\n" for x, y in rounded)
    with system_errors_as(InvalidInputError, f"{path}: cannot be written"):
        path.write_text(f"{','.join(_CSV_COLUMNS)}\n{rows}", encoding="utf-8")


def _csv(text: str, name: str) -> FloatArray:
    try:
        rows = list(csv.reader(text.splitlines()))
    except csv.Error as error:
        raise InvalidInputError(f"{name}: not a CSV file: {error}") from error
    if not rows or [cell.strip() for cell in rows[0]] != _CSV_COLUMNS:
        raise InvalidInputError(
            f"{name}: the first line must be {','.join(_CSV_COLUMNS)}; other tables are imported "
            f"first: nufleet drawing import {name} --out NEW.csv"
        )
    points = []
    for number, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        try:
            x, y = (float(cell) for cell in row)
        except ValueError as error:
            raise InvalidInputError(
                f"{name}, line {number}: expected two numbers, got {row!r:.80}"
            ) from error
        points.append((x, y))
    return np.array(points, dtype=np.float64).reshape(-1, 2)
