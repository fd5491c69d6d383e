"""Drawings that can be given by name instead of by path."""

from __future__ import annotations

from pathlib import Path

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.installed import find_file, installed

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
    return find_file(path_or_name, ENTRY_POINT_GROUP, "drawing", InvalidInputError)


def drawing_names() -> tuple[str, ...]:
    """Return the names of the drawings that are installed."""
    return tuple(sorted(installed(ENTRY_POINT_GROUP)))
