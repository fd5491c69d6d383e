"""Files that belong to one user: replaced as a whole, readable by nobody else."""

from __future__ import annotations

import os
from pathlib import Path


def make_private_folder(folder: Path) -> None:
    """Make sure that a folder is there and that nobody else may look into it (mode 0700).

    Folders above it that are missing are made as private; those that are there stay as they are.

    Raises:
        OSError: it cannot be made, or belongs to somebody else.
    """
    for made in (*reversed(folder.parents), folder):
        if not made.exists():
            made.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)


def write_privately(path: Path, data: bytes) -> None:
    """Replace a file as a whole: after a crash there is all of it or what was there before.

    Raises:
        OSError: it could not be written; what was there before still is.
    """
    os.close(replace_privately(path, data, path.with_name(f"{path.name}.part")))


def replace_privately(path: Path, data: bytes, part: Path) -> int:
    """Put a new file into the place of `path`, durably, and return its descriptor, which appends.

    The bytes go to `part` first, a name in the same folder. What lies there is removed, never
    written to: a link that somebody put there would lead the bytes elsewhere.

    Raises:
        OSError: it could not be written; `part` is gone, and what was at `path` still is there
            unless the folder itself could not be synchronised.
    """
    part.unlink(missing_ok=True)
    flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(part, flags, 0o600)
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
        part.replace(path)
        synchronise_folder(path.parent)
    except OSError:
        os.close(descriptor)
        part.unlink(missing_ok=True)
        raise
    return descriptor


def write_all(descriptor: int, data: bytes) -> None:
    """Write all of the bytes, however many calls that takes; raises OSError."""
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def synchronise_folder(folder: Path) -> None:
    """Return when the names in a folder are on the disk; raises OSError."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
