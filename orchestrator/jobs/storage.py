"""Where commands keep what they do, and the words that find it again."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

from nufleet.orchestrator.environment import REPOSITORY_VARIABLE
from nufleet.orchestrator.repository.database import default_url, name_of
from nufleet.orchestrator.repository.errors import LeaseLostError
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.command_line import invocation
from nufleet.shared.errors import NufleetError, StudyError


@dataclass(frozen=True)
class Storage:
    """Where runs leave their folders, and the repository: None is the one in that folder."""

    runs_root: Path
    repository: str | None = None

    @property
    def _address(self) -> str:
        return self.repository or default_url(self.runs_root)

    def open(self) -> Repository:
        """Open the repository; raises RepositoryError."""
        return open_repository(self._address)

    def document(self) -> dict[str, str]:
        """Return both for a run's configuration, without a password."""
        return {"runs_root": str(self.runs_root), "repository": name_of(self._address)}

    def resume_command(self, run: str) -> str:
        """Return what to type to go on with a run."""
        words = ["runs", "resume", run]
        if self.runs_root != Path("runs"):
            words += ["--runs", str(self.runs_root)]
        # Without its password it could not be typed again; the environment still has it.
        if self.repository not in (None, os.environ.get(REPOSITORY_VARIABLE)):
            words += ["--repository", name_of(self._address)]
        return f"{invocation()} {shlex.join(words)}"

    @contextmanager
    def saying_how_to_resume(self, console: Console, run: str) -> Iterator[None]:
        """Say how a run goes on that Ctrl-C ends, or an error that is not the study's own."""
        try:
            yield
        except (StudyError, LeaseLostError):
            raise
        except (KeyboardInterrupt, NufleetError, OSError):
            console.print(f"it can go on where it was:  {self.resume_command(run)}")
            raise
