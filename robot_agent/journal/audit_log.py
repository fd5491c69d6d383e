"""Who asked a robot for what, when, and what was answered: an append-only, hash-chained file.

Each line holds the SHA-256 of the line before it, so that a line that was changed, removed or
inserted breaks the chain. Lines cut off at the end leave it whole: compare the last digest with one
that was noted elsewhere.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import os
import threading
from collections import deque
from collections.abc import Iterator
from concurrent.futures import Executor, Future, wait
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

from pydantic import Field, ValidationError

from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.private_files import make_private_folder, write_all
from nufleet.shared.strict import Digest, Name, Reason, Strict, describe_validation
from nufleet.shared.text import as_reason

AUDIT_LOG = "audit.jsonl"
NOTHING_BEFORE = "0" * 64
"""Digest that the first line holds."""

MOST_WAITING = 4096
"""Largest number of entries that wait for the disk; further ones are counted, not kept."""

ABOUT_MAX_CHARACTERS = 400
MAX_LINE_BYTES = 16 * 1024
"""Longer than any line: texts are cut to length, and no character takes more than 6 bytes."""

_log = logging.getLogger(__name__)


class AuditEntry(Strict):
    """One line of an audit log."""

    time: str
    """Time at which the request was answered, in UTC, ISO 8601."""
    principal: Name | None
    """Principal that the key named, which the router of a closed fleet has proven; None if the key
    named none."""
    sender: Reason
    """Id of the sender, as the request states it."""
    asked: str
    """End of the request's key, such as `goal` or `stop`."""
    about: Reason
    """Subject of the request: a goal, a digest or a reason."""
    epoch: int | None
    """Epoch of the sender's lease; None for requests that need none."""
    answer: Reason
    """`done`, `accepted`, or the code and the reason of a refusal."""
    missed: Annotated[int, Field(ge=0)]
    """Number of entries just before this one that could not be kept."""
    before: Digest
    """SHA-256 of the line before this one, in hexadecimal."""


@dataclass(frozen=True)
class Verified:
    """What a check of an audit log found."""

    entries: int
    """Number of entries that follow from each other, from the beginning on."""
    digest: str
    """Digest of the last of them."""
    broken: str | None
    """Where and how the chain breaks; None if it is whole."""


class AuditLog:
    """Has other threads write its entries, so that neither a stop nor a goal waits for the disk."""

    def __init__(self, folder: Path, writer: Executor) -> None:
        """Open the log of a robot, or begin one.

        A line that was not finished when the machine lost power is removed.

        Args:
            folder: State folder of the robot.
            writer: What writes the entries, which outlives this.

        Raises:
            JournalError: The log cannot be opened, or is a link.
        """
        self._path = folder / AUDIT_LOG
        flags = os.O_RDWR | os.O_APPEND | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        try:
            make_private_folder(folder)
            self._file = os.open(self._path, flags, 0o600)
            self._before = _digest_of_the_end(self._file)
        except OSError as error:
            raise JournalError(f"the audit log {self._path}: {error.strerror}") from error
        self._writer = writer
        self._lock = threading.Lock()
        self._waiting: deque[dict[str, object]] = deque()
        self._missed = 0
        self._writing: Future[None] | None = None
        self._closed = False

    def record(
        self,
        principal: str | None,
        sender: str,
        asked: str,
        about: str,
        answer: str,
        *,
        epoch: int | None = None,
    ) -> None:
        """Record an answered request; returns at once.

        Args:
            principal: Principal that the key named; None if it named none.
            sender: Id of the sender, as the request states it.
            asked: End of the request's key.
            about: Subject of the request.
            answer: The answer, for people.
            epoch: Epoch of the sender's lease; None for a request that needs none.
        """
        entry: dict[str, object] = {
            "time": datetime.now(UTC).isoformat(timespec="milliseconds"),
            "principal": principal,
            "sender": as_reason(sender)[:200],
            "asked": asked,
            "about": as_reason(about)[:ABOUT_MAX_CHARACTERS],
            "epoch": epoch,
            "answer": as_reason(answer)[:ABOUT_MAX_CHARACTERS],
        }
        with self._lock:
            if self._closed or len(self._waiting) == MOST_WAITING:
                self._missed += 1
                return
            self._waiting.append(entry)
            if self._writing is None:
                self._writing = self._writer.submit(self._write)

    def close(self) -> None:
        """Write what waits, and end; idempotent."""
        with self._lock:
            closed, self._closed = self._closed, True
            writing = self._writing
        if writing is not None:
            wait([writing])
        if not closed:
            os.close(self._file)

    def _write(self) -> None:
        while True:
            with self._lock:
                if not self._waiting:
                    self._writing = None
                    return
                entry, last = self._waiting.popleft(), not self._waiting
                missed, self._missed = self._missed, 0
            document = {**entry, "missed": missed, "before": self._before}
            line = json.dumps(document, ensure_ascii=False, separators=(",", ":")).encode()
            try:
                write_all(self._file, line + b"\n")
                if last:
                    os.fsync(self._file)
            except OSError as error:
                _log.error("%s: an entry could not be written: %s", self._path, error)
                with self._lock:
                    self._missed += missed + 1
                with contextlib.suppress(OSError):
                    self._before = _digest_of_the_end(self._file)
            else:
                self._before = hashlib.sha256(line).hexdigest()


def read_audit_log(path: Path) -> Iterator[AuditEntry]:
    """Yield the entries of an audit log in their order; raises InvalidInputError if one is none."""
    for number, line in enumerate(_lines(path), start=1):
        try:
            yield AuditEntry.model_validate_json(line)
        except ValidationError as error:
            where = f"{path}, line {number}"
            raise InvalidInputError(f"{where}: {describe_validation(error)}") from error


def verified(path: Path, *, digest: str | None = None) -> Verified:
    """Check that each entry of an audit log follows from the one before it.

    Args:
        path: Audit log.
        digest: Digest of an entry that the log must contain; None to look for none.

    Raises:
        InvalidInputError: The log cannot be read.
    """
    entries, before, met = 0, NOTHING_BEFORE, digest in (None, NOTHING_BEFORE)
    for line in _lines(path):
        try:
            entry = AuditEntry.model_validate_json(line)
        except ValidationError as error:
            problem = f"line {entries + 1} is no entry: {describe_validation(error)}"
            return Verified(entries, before, problem)
        if entry.before != before:
            problem = f"line {entries + 1} does not follow from the line before it"
            return Verified(entries, before, problem)
        entries, before = entries + 1, hashlib.sha256(line).hexdigest()
        met = met or before == digest
    lost = None if met else f"the entry with digest {digest} is missing"
    return Verified(entries, before, lost)


def _lines(path: Path) -> Iterator[bytes]:
    try:
        with path.open("rb") as file:
            for line in file:
                if line.endswith(b"\n"):  # the agent may be writing the last one
                    yield line[:-1]
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror}") from error


def _digest_of_the_end(file: int) -> str:
    """Return the digest of the last whole line of an open log, and remove an unfinished one."""
    size = os.fstat(file).st_size
    start = max(0, size - MAX_LINE_BYTES)
    end = os.pread(file, size - start, start)
    whole = end[: end.rfind(b"\n") + 1]
    if len(whole) < len(end):
        os.ftruncate(file, start + len(whole))
    if not whole:
        return NOTHING_BEFORE
    return hashlib.sha256(whole[:-1].rpartition(b"\n")[2]).hexdigest()
