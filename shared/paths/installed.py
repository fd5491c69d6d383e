"""Drawings that can be given by name instead of by path."""

from __future__ import annotations

from importlib.metadata import entry_points
from pathlib import Path

from nufleet.shared.errors import InvalidInputError

ENTRY_POINT_GROUP = "nufleet.drawings"


def find_drawing(path_or_name: str) -> Path:
    """Return the path of a drawing that is given by its path or by the name of an installed one.

    The file itself is read by `nufleet.shared.paths.files.read_drawing`.

    Args:
        path_or_name: Path of a file, or name in the entry-point group `nufleet.drawings`.

    Raises:
        InvalidInputError: there is neither such a file nor such a name.

    Examples:
        >>> find_drawing("clover").suffix
        '.csv'
    """
    path = Path(path_or_name)
    if path.exists():
        return path
    installed = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}
    if path_or_name not in installed:
        names = ", ".join(sorted(installed)) or "none"
        raise InvalidInputError(f"{path}: no such drawing; known by name: {names}")
    found: Path = installed[path_or_name].load()
    return found


def drawing_names() -> tuple[str, ...]:
    """Return the names of the drawings that are installed."""
    return tuple(sorted({entry.name for entry in entry_points(group=ENTRY_POINT_GROUP)}))
