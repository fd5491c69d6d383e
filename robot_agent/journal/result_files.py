"""The files of the results that a robot keeps, which are written over what is no longer needed.

A new file would have to be named, and its name to be on disk, too, before its result counts. A
result is known by its digest instead, which the journal holds: a file that holds no result of the
journal, as after a crash while it was written, is one that may be removed.
"""

from __future__ import annotations

import hashlib
import os
import threading
from collections.abc import Mapping
from pathlib import Path

from nufleet.shared.private_files import synchronise_folder, write_all

SPARE_BYTES_MAX = 2**20
"""Size up to which a file is kept to be written over, so that no disk fills up with old results."""


class ResultFiles:
    """Files in a folder that belongs to one journal; usable from many threads."""

    def __init__(self, folder: Path, kept: Mapping[str, str]) -> None:
        """Find the results that are there, and remove all other files.

        Args:
            folder: Folder of the files.
            kept: Digests of the results that are kept, by the ids of their goals.

        Raises:
            OSError: The folder cannot be read or written.
        """
        self._folder = folder
        self._lock = threading.Lock()
        self._paths: dict[str, Path] = {}
        self._spare: Path | None = None
        self._number = 0
        goals = {sha256: goal_id for goal_id, sha256 in kept.items()}
        for path in folder.iterdir():
            goal_id = goals.get(hashlib.sha256(path.read_bytes()).hexdigest())
            if goal_id is None:
                path.unlink()
            else:
                self._paths[goal_id] = path

    def store(self, goal_id: str, data: bytes) -> None:
        """Store a result durably; nothing counts before the journal holds its digest.

        Raises:
            OSError: It cannot be stored.
        """
        path, new = self._place()
        flags = os.O_WRONLY | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
        descriptor = os.open(path, flags | (os.O_EXCL if new else 0), 0o600)
        try:
            write_all(descriptor, data)
            os.ftruncate(descriptor, len(data))
            os.fdatasync(descriptor)
            if new:
                synchronise_folder(self._folder)
        except OSError:
            path.unlink(missing_ok=True)
            raise
        finally:
            os.close(descriptor)
        with self._lock:
            self._paths[goal_id] = path

    def read(self, goal_id: str) -> bytes:
        """Return what was stored.

        Raises:
            OSError: It is gone, or cannot be read.
        """
        with self._lock:
            path = self._paths.get(goal_id)
        if path is None:
            raise FileNotFoundError(f"its file is not in {self._folder}")
        return path.read_bytes()

    def drop(self, goal_id: str) -> None:
        """Let go of a result, whose file may now be written over.

        Raises:
            OSError: The file cannot be removed.
        """
        with self._lock:
            path = self._paths.pop(goal_id, None)
            if path is None or not path.exists():
                return
            if self._spare is None and path.stat().st_size <= SPARE_BYTES_MAX:
                self._spare = path
            else:
                path.unlink(missing_ok=True)

    def _place(self) -> tuple[Path, bool]:
        """Return where to write the next result, and whether that is a new file."""
        with self._lock:
            spare, self._spare = self._spare, None
            if spare is not None and spare.exists():
                return spare, False
            path = self._folder / f"result-{self._number}"
            while path.exists():
                self._number += 1
                path = self._folder / f"result-{self._number}"
            self._number += 1
            return path, True
