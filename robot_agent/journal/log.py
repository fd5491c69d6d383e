"""The log file of a journal: appended to and replaced durably, even when the disk fails."""

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
        """Take over an open log, positioned at its end.

        Args:
            path: Path of the log.
            descriptor: Descriptor open for writing, which this object closes.
            salt: Salt of the log, the key of its checksums.
            number: Number of its last frame; 0 without any.
            size: Size of the log in bytes.
        """
        self._path = path
        self._descriptor = descriptor
        self._salt = salt
        self._number = number
        self._size_bytes = size
        self._in_doubt: str | None = None

    @property
    def size_bytes(self) -> int:
        """Size of the log in bytes."""
        return self._size_bytes

    def append(self, payload: bytes, *, durable: bool = True) -> None:
        """Store a record.

        Args:
            payload: Encoded record.
            durable: Whether it is on disk when this returns, with all records before it; otherwise
                it survives this process, but not a power failure before the next durable record.

        Raises:
            JournalError: The record is not stored. When the content of the disk is in doubt, this
                log stores nothing more.
        """
        if self._in_doubt is not None:
            raise JournalError(f"{self._path} accepts no more records: {self._in_doubt}")
        frame = encode_frame(self._salt, self._number + 1, payload)
        try:
            private_files.write_all(self._descriptor, frame)
        except OSError as error:
            self._restore()
            raise JournalError(
                f"{self._path}: {error.strerror}; free or repair the disk; no goals are accepted "
                "until then"
            ) from error
        try:
            if durable:
                os.fdatasync(self._descriptor)
        except OSError as error:
            # After a failed sync the system may have discarded the data it could not write, so a
            # second sync that succeeds would prove nothing.
            self._in_doubt = f"the disk failed: {error.strerror}; restart the agent"
            raise JournalError(f"{self._path}: {self._in_doubt}") from error
        self._number += 1
        self._size_bytes += len(frame)

    def check_in_place(self) -> None:
        """Check, after a failed replacement, that this log is still the one at its path.

        If the replacement did take place, this log stores nothing more: a record appended to a file
        that will never be read again would be lost.
        """
        try:
            in_place = os.path.samestat(self._path.stat(), os.fstat(self._descriptor))
        except OSError:
            in_place = False
        if not in_place:
            self._in_doubt = "it was replaced, and the disk failed; restart the agent"

    def close(self) -> None:
        """Close the file; nothing more is stored."""
        if self._descriptor >= 0:
            self._in_doubt = self._in_doubt or "it is closed"
            os.close(self._descriptor)
            self._descriptor = -1

    def _restore(self) -> None:
        """Remove a half-written frame, which would look like damage in the middle of the log."""
        try:
            os.ftruncate(self._descriptor, self._size_bytes)
        except OSError as error:
            self._in_doubt = f"it could not be restored after an error: {error.strerror}"


def read_log(path: Path) -> tuple[Scan, bytes]:
    """Return the records found in a log, and its bytes."""
    data = path.read_bytes()
    return scan(data), data


def continue_log(path: Path, found: Scan) -> LogFile:
    """Open an undamaged log for appending after its last whole record, with a torn end cut off."""
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
    """Write a new log and replace the old one with it atomically.

    Args:
        path: Path of the log.
        payloads: Encoded records, in order.
        temporary: Path on the same file system at which the new log is written first.

    Returns:
        The new log, open for appending.
    """
    salt = secrets.token_bytes(SALT_BYTES)
    frames = [encode_frame(salt, n, payload) for n, payload in enumerate(payloads, start=1)]
    data = file_head(salt) + b"".join(frames)
    descriptor = private_files.replace_privately(path, data, temporary)
    return LogFile(path, descriptor, salt, len(frames), len(data))
