"""Files that belong to one user: replaced as a whole, and readable by no other user."""

from __future__ import annotations

import os
from pathlib import Path

from nufleet.shared.errors import InvalidInputError


def make_private_folder(folder: Path) -> None:
    """Make sure that a folder exists and that no other user may look into it (mode 0700).

    Missing folders above it are created with the same mode; existing ones stay unchanged.

    Args:
        folder: Folder to create or to make private.

    Raises:
        OSError: it cannot be created, or belongs to another user.
    """
    for made in (*reversed(folder.parents), folder):
        if not made.exists():
            made.mkdir(mode=0o700, exist_ok=True)
    folder.chmod(0o700)


def write_privately(path: Path, data: bytes) -> None:
    """Replace a file atomically: after a crash it holds either the new contents or the old ones.

    Args:
        path: File to replace or create, readable only by its owner.
        data: New contents.

    Raises:
        OSError: the file could not be written; its old contents are unchanged.
    """
    os.close(replace_privately(path, data, path.with_name(f"{path.name}.part")))


def check_private(path: Path) -> None:
    """Check that this user alone can read a file with a key.

    Args:
        path: File of the key.

    Raises:
        InvalidInputError: This user cannot read it, or others can.
        OSError: It is not there.
    """
    mode = path.stat().st_mode
    if not os.access(path, os.R_OK):
        raise InvalidInputError(f"the key {path} belongs to another user")
    if mode & 0o077:
        raise InvalidInputError(f"other users can read or replace the key {path}: chmod 600 {path}")


def create_privately(path: Path, data: bytes) -> None:
    """Write a new file that only its owner may read, and never replace one that exists.

    Args:
        path: File to create.
        data: Contents of the file.

    Raises:
        FileExistsError: there is such a file already; it is unchanged.
        OSError: the file could not be written.
    """
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW | os.O_CLOEXEC
    descriptor = os.open(path, flags, 0o600)
    try:
        write_all(descriptor, data)
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
    synchronise_folder(path.parent)


def replace_privately(path: Path, data: bytes, part: Path) -> int:
    """Replace `path` durably by a new file, and return its descriptor, opened for appending.

    The bytes are first written to `part`. A file that already exists there is removed and never
    written to, because a link placed there by another user would redirect the bytes.

    Args:
        path: File to replace or create, readable only by its owner.
        data: Contents of the new file.
        part: Temporary path in the same folder.

    Raises:
        OSError: the file could not be written. `part` is removed, and `path` has its old contents
            unless it was only the folder that could not be synchronised.
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
    """Write all of the bytes, in as many calls as it takes.

    Raises:
        OSError: a call failed; some of the bytes may have been written.
    """
    rest = memoryview(data)
    while rest:
        rest = rest[os.write(descriptor, rest) :]


def synchronise_folder(folder: Path) -> None:
    """Wait until the names in a folder are stored durably on the disk.

    Raises:
        OSError: the folder cannot be opened or synchronised.
    """
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
