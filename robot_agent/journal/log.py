"""The log of a journal on a disk: appended to and replaced, durably, whatever the disk does."""

from __future__ import annotations

import os
import secrets
from collections.abc import Iterable
from pathlib import Path

from nufleet.robot_agent.journal.frames import SALT_BYTES, Scan, encode_frame, file_head, scan
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.shared import private_files


class LogFile:
    """A log that is open for appending, by one thread at a time."""

    def __init__(self, path: Path, descriptor: int, salt: bytes, number: int, size: int) -> None:
        """Take over a descriptor whose position is the end of a log of `number` frames."""
        self._path = path
        self._descriptor = descriptor
        self._salt = salt
        self._number = number
        self._size_bytes = size
        self._in_doubt: str | None = None

    @property
    def size_bytes(self) -> int:
        """How long the log is."""
        return self._size_bytes

    def append(self, payload: bytes) -> None:
        """Store a record; it is on disk when this returns.

        Raises:
            JournalError: it is not stored. When the disk leaves in doubt what it holds, nothing
                is stored any more.
        """
        if self._in_doubt is not None:
            raise JournalError(f"{self._path} takes no more records: {self._in_doubt}")
        frame = encode_frame(self._salt, self._number + 1, payload)
        try:
            private_files.write_all(self._descriptor, frame)
        except OSError as error:
            self._restore()
            raise JournalError(
                f"{self._path}: {error.strerror}; see to the disk, nothing is accepted until then"
            ) from error
        try:
            os.fdatasync(self._descriptor)
        except OSError as error:
            # The system may have dropped what it could not write; trying again would prove nothing.
            self._in_doubt = f"the disk failed: {error.strerror}; restart the agent"
            raise JournalError(f"{self._path}: {self._in_doubt}") from error
        self._number += 1
        self._size_bytes += len(frame)

    def check_in_place(self) -> None:
        """After a failed replacement: store nothing any more if it took place nevertheless.

        What is appended to a log that nobody will read again is not stored.
        """
        try:
            in_place = os.path.samestat(self._path.stat(), os.fstat(self._descriptor))
        except OSError:
            in_place = False
        if not in_place:
            self._in_doubt = "it was replaced, and the disk failed; restart the agent"

    def close(self) -> None:
        """Store nothing any more."""
        if self._descriptor >= 0:
            self._in_doubt = self._in_doubt or "it is closed"
            os.close(self._descriptor)
            self._descriptor = -1

    def _restore(self) -> None:
        """Take half a frame away: in the middle of a log it would look like damage."""
        try:
            os.ftruncate(self._descriptor, self._size_bytes)
        except OSError as error:
            self._in_doubt = f"it could not be restored after an error: {error.strerror}"


def read_log(path: Path) -> tuple[Scan, bytes]:
    """Return what a log holds, and its bytes."""
    data = path.read_bytes()
    return scan(data), data


def continue_log(path: Path, found: Scan) -> LogFile:
    """Open a log without damage behind its last whole record; what is torn is cut off."""
    descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_NOFOLLOW | os.O_CLOEXEC)
    try:
        if found.torn_bytes:
            os.ftruncate(descriptor, found.sound_bytes)
            os.fsync(descriptor)
    except OSError:
        os.close(descriptor)
        raise
    return LogFile(path, descriptor, found.salt, found.last_number, found.sound_bytes)


def replace_log(path: Path, payloads: Iterable[bytes], temporary: Path) -> LogFile:
    """Write a new log and put it into the place of the old one, all at once."""
    salt = secrets.token_bytes(SALT_BYTES)
    frames = [encode_frame(salt, n, payload) for n, payload in enumerate(payloads, start=1)]
    data = file_head(salt) + b"".join(frames)
    descriptor = private_files.replace_privately(path, data, temporary)
    return LogFile(path, descriptor, salt, len(frames), len(data))
