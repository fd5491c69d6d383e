"""Files of keys and requests: made once, private, and named by every error."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from nufleet.orchestrator.authority.certificates import (
    MAX_REQUEST_BYTES,
    key_pem,
    new_key,
    request_pem,
)
from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.private_files import create_privately, make_private_folder, write_privately
from nufleet.shared.wire.identity import KEY_SUFFIX

REQUEST_SUFFIX = ".request"


@contextmanager
def named_files() -> Iterator[None]:
    """Turn the error of a file that cannot be read or written into one that names it."""
    try:
        yield
    except OSError as error:
        where = "" if error.filename is None else f"{error.filename}: "
        raise InvalidInputError(f"{where}{error.strerror}") from error


def create_folder(folder: Path) -> None:
    """Create a private folder; one that exists keeps its mode, since it may hold more than this."""
    if not folder.exists():
        make_private_folder(folder)


def create_key(path: Path, pem: bytes) -> None:
    """Write a private key; raises InvalidInputError if there is a file already."""
    try:
        create_privately(path, pem)
    except FileExistsError as error:
        raise InvalidInputError(f"{path} exists, and a key is never replaced") from error


def read_request(path: Path) -> bytes:
    """Return the contents of a request; of a file that is no request, the beginning."""
    advice = "; `nufleet fleet request` wrote it on the machine of its principal: copy it here"
    unread = system_errors_as(InvalidInputError, f"{path}: cannot be read", advice)
    with unread, path.open("rb") as file:
        return file.read(MAX_REQUEST_BYTES)


def make_request(name: str, folder: Path) -> tuple[Path, Path]:
    """Make a key, and a request for a certificate of it, on the machine that will use the key.

    Args:
        name: Principal of the inventory.
        folder: Folder for both files; created if it is missing, and then private.

    Returns:
        The paths of the key and of the request.

    Raises:
        InvalidInputError: There is a key of this name, which is never replaced, or a file cannot be
            written.
    """
    key = new_key()
    path, request = folder / f"{name}{KEY_SUFFIX}", folder / f"{name}{REQUEST_SUFFIX}"
    with named_files():
        create_folder(folder)
        create_key(path, key_pem(key))
        write_privately(request, request_pem(key, name))
    return path, request
