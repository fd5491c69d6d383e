"""Reading of drawn paths from files (CSV in metres, or the one path of an SVG), writing as CSV."""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.trajectories import POINTS_MAX, check_path

FILE_BYTES_MAX = 8 * 2**20
"""Largest accepted file; a hundred thousand points with ten digits each take 3 MB."""

SVG_EXTENT_M = 2.4
"""Length given to the longer side of an SVG, which has no metres; it is centred on the origin."""

SVG_NUMBER_MAX = 1e9
"""Largest accepted coordinate; no drawing needs larger ones, and their sums would overflow."""

_CSV_COLUMNS = ["x_m", "y_m"]
_CURVE_POINTS = 24
_PATH_DATA = re.compile(r"<path\b[^>]*?\sd\s*=\s*([\"'])(?P<data>.*?)\1", re.DOTALL)
_TOKEN = re.compile(
    r"\s*,?\s*(?:(?P<command>[A-Za-z])|(?P<number>[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?))"
)
_ARGUMENTS = {"M": 2, "L": 2, "H": 1, "V": 1, "C": 6, "Q": 4, "Z": 0}


def read_drawing(path: Path) -> FloatArray:
    """Return the points of a drawing, shape (n, 2), in m.

    Args:
        path: File with the ending .csv or .svg.

    Raises:
        InvalidInputError: the file cannot be read, is neither CSV nor SVG, does not contain exactly
            one path, or contains an invalid one (one point, NaN, too many points). The message
            names the file and the fault.

    Examples:
        >>> from nufleet.shared.paths.installed import find_drawing
        >>> read_drawing(find_drawing("clover")).shape
        (312, 2)
    """
    readers: dict[str, Callable[[str, str], FloatArray]] = {".csv": _csv, ".svg": _svg}
    reader = readers.get(path.suffix.lower())
    if reader is None:
        raise InvalidInputError(f"{path}: a drawing must be a .csv or .svg file")
    try:
        if path.stat().st_size > FILE_BYTES_MAX:
            raise InvalidInputError(f"{path}: larger than {FILE_BYTES_MAX} bytes")
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InvalidInputError(f"{path}: cannot be read: {error}") from error
    points = reader(text, str(path))
    check_path(points, str(path))
    return points


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
    try:
        path.write_text(f"{','.join(_CSV_COLUMNS)}\n{rows}", encoding="utf-8")
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be written: {error.strerror}") from error


def _csv(text: str, name: str) -> FloatArray:
    try:
        rows = list(csv.reader(text.splitlines()))
    except csv.Error as error:
        raise InvalidInputError(f"{name}: not a CSV file: {error}") from error
    if not rows or [cell.strip() for cell in rows[0]] != _CSV_COLUMNS:
        raise InvalidInputError(f"{name}: the first line must be {','.join(_CSV_COLUMNS)}")
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


def _svg(text: str, name: str) -> FloatArray:
    # Only path data are needed; an XML parser would accept far more from an untrusted file.
    found = [match["data"] for match in _PATH_DATA.finditer(text)]
    if len(found) != 1:
        raise InvalidInputError(f"{name}: expected one <path> with data, found {len(found)}")
    if re.search(r"\stransform\s*=", text):
        raise InvalidInputError(f"{name}: apply its transformations before importing it")
    points = np.array(_drawn(found[0], name), dtype=np.float64)
    check_path(points, name)
    low, high = points.min(axis=0), points.max(axis=0)
    extent = float((high - low).max())
    if extent < 1 / SVG_NUMBER_MAX:
        raise InvalidInputError(f"{name}: the path is only {extent:g} units long")
    scale = SVG_EXTENT_M / extent
    return np.asarray((points - (low + high) / 2) * scale * np.array([1.0, -1.0]))


def _drawn(data: str, name: str) -> list[tuple[float, float]]:
    """Return the points of SVG path data, with curves replaced by chords."""
    points: list[tuple[float, float]] = []
    here = start = 0j
    for command, numbers in _segments(data, name):
        kind, relative = command.upper(), command.islower()
        origin = here if relative else 0j
        if kind == "M":
            if points:
                raise InvalidInputError(f"{name}: the pen may not be lifted: one subpath only")
            here = start = origin + complex(*numbers)
            points.append((here.real, here.imag))
            continue
        if kind == "H":
            knots = [here, complex(origin.real + numbers[0], here.imag)]
        elif kind == "V":
            knots = [here, complex(here.real, origin.imag + numbers[0])]
        elif kind == "Z":
            knots = [here, start]
        else:
            ends = [
                origin + complex(x, y) for x, y in zip(numbers[::2], numbers[1::2], strict=True)
            ]
            knots = [here, *ends]
        points += [(z.real, z.imag) for z in _bezier(knots)]
        here = knots[-1]
        if len(points) > POINTS_MAX:
            raise InvalidInputError(f"{name}: more than {POINTS_MAX} points")
    return points


def _bezier(knots: list[complex]) -> list[complex]:
    """Return the points of a Bézier curve after its first knot; for a line, only its end."""
    degree = len(knots) - 1
    if degree == 1:
        return knots[1:]
    t = np.arange(1, _CURVE_POINTS + 1) / _CURVE_POINTS
    terms = [math.comb(degree, i) * t**i * (1 - t) ** (degree - i) * z for i, z in enumerate(knots)]
    return [complex(z) for z in np.sum(terms, axis=0)]


def _segments(data: str, name: str) -> Iterator[tuple[str, list[float]]]:
    """Yield each command with its numbers; further numbers repeat the command."""
    command, numbers, at = "", list[float](), 0
    data = data.strip()
    while at < len(data):
        token = _TOKEN.match(data, at)
        if token is None:
            raise InvalidInputError(f"{name}: path data not understood at {data[at : at + 20]!r}")
        at = token.end()
        if token["command"]:
            if numbers:
                raise InvalidInputError(f"{name}: {command!r} with a wrong count of numbers")
            command = token["command"]
            if command.upper() not in _ARGUMENTS:
                raise InvalidInputError(f"{name}: path command {command!r} is not supported")
        else:
            numbers.append(float(token["number"]))
            if abs(numbers[-1]) > SVG_NUMBER_MAX:
                raise InvalidInputError(
                    f"{name}: a number that is not finite or beyond ±{SVG_NUMBER_MAX:g}"
                )
            if command.upper() in {"", "Z"}:
                raise InvalidInputError(f"{name}: a number without a command")
        if command and len(numbers) == _ARGUMENTS[command.upper()]:
            yield command, numbers
            # Further pairs after a move are lines.
            command = {"M": "L", "m": "l"}.get(command, command) if numbers else command
            numbers = []
    if numbers:
        raise InvalidInputError(f"{name}: {command!r} with a wrong count of numbers")
