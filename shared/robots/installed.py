"""What packages install under a name: drivers, fleet files and drawings."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

from nufleet.shared.errors import NufleetError, system_errors_as


def installed(group: str) -> dict[str, EntryPoint]:
    """Return the entries of an entry-point group, by name."""
    return {entry.name: entry for entry in entry_points(group=group)}


def find_file(path_or_name: str, group: str, what: str, kind: type[NufleetError]) -> Path:
    """Return the path of a file that is given by its path or by the name of an installed one.

    Args:
        path_or_name: Path of a file, or name in the group. A folder may happen to have that name.
        group: Entry-point group of the installed files.
        what: What the file is, for the error message.
        kind: Type of the error if there is neither such a file nor such a name.
    """
    path = Path(path_or_name)
    with system_errors_as(kind, f"{path}: cannot be read"):
        if path.exists() and not path.is_dir():
            return path
    entries = installed(group)
    if path_or_name not in entries:
        names = ", ".join(sorted(entries)) or "none"
        raise kind(f"{path}: no such {what}; known by name: {names}")
    found: Path = entries[path_or_name].load()
    return found
