"""Drawings that can be given by name instead of by path."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

from nufleet.shared.errors import InvalidInputError

ENTRY_POINT_GROUP = "nufleet.drawings"


def find_drawing(path_or_name: str) -> Path:
    """Return the path of a drawing given as a path, or by the name of one that is installed.

    What it holds is read by `nufleet.shared.paths.files.read_drawing`.

    Raises:
        InvalidInputError: it is neither.
    """
    path = Path(path_or_name)
    if path.exists():
        return path
    installed = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if path_or_name not in installed:
        names = ", ".join(sorted(installed)) or "none"
        raise InvalidInputError(f"{path}: there is no such drawing; known by name: {names}")
    found: Path = installed[path_or_name].load()
    return found


def drawing_names() -> tuple[str, ...]:
    """Return the names of the drawings that are installed."""
    return tuple(sorted({entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)}))
