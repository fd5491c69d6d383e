"""The places where commands store their runs, and the command line that resumes a run."""

from __future__ import annotations

import os
import shlex
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from rich.console import Console

from nufleet.orchestrator.conduct.replay import ResumeError
from nufleet.orchestrator.jobs.environment import REPOSITORY_VARIABLE
from nufleet.orchestrator.repository.address import default_url, is_file, name_of, parse_url
from nufleet.orchestrator.repository.errors import LeaseLostError, UnknownRecordError
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.command_line import invocation
from nufleet.shared.errors import NufleetError, StudyError


@dataclass(frozen=True)
class Storage:
    """The places where a command stores its run."""

    runs_root: Path
    """Folder that holds the folders of all runs."""
    repository: str | None = None
    """Address of the repository; None for the one in `runs_root`."""

    @staticmethod
    def of_run(runs_root: Path, configuration: Mapping[str, Any]) -> Storage:
        """Return the places of an earlier run, without the password of its repository.

        Args:
            runs_root: Folder in which the run's folder is now.
            configuration: Configuration of the run.
        """
        kept, root = configuration.get("repository"), configuration.get("runs_root")
        beside = root is not None and kept == name_of(default_url(Path(root)))
        return Storage(runs_root, None if kept is None or beside else str(kept))

    @property
    def name(self) -> str:
        """Address of the repository without a password."""
        return name_of(self._address)

    @property
    def exists(self) -> bool:
        """Whether the repository is there, if it is a file; one on a server is taken to be."""
        return not is_file(self._address) or Path(str(parse_url(self._address).database)).exists()

    def lacks(self, study_id: str) -> bool:
        """Whether the repository is a file that does not hold this study."""
        if not is_file(self._address):
            return False
        if not self.exists:
            return True
        with self.open() as repository:
            try:
                repository.studies.study(study_id)
            except UnknownRecordError:
                return True
        return False

    @property
    def _address(self) -> str:
        return self.repository or default_url(self.runs_root)

    def open(self) -> Repository:
        """Open the repository; raises RepositoryError when that fails."""
        return open_repository(self._address)

    def document(self) -> dict[str, str]:
        """Return both places for a run's configuration, without a password."""
        return {"runs_root": str(self.runs_root), "repository": self.name}

    def resume_command(self, run: str) -> str:
        """Return the command line that resumes a run."""
        words = ["runs", "resume", run]
        if self.runs_root != Path("runs"):
            words += ["--runs", str(self.runs_root)]
        # An address is printed without its password and could not be typed again; one that comes
        # from the environment need not be, since the environment still holds it.
        if self.repository not in (None, os.environ.get(REPOSITORY_VARIABLE)):
            words += ["--repository", self.name]
        return f"{invocation()} {shlex.join(words)}"

    @contextmanager
    def saying_how_to_resume(self, console: Console, run: str) -> Iterator[None]:
        """Print how to resume the run if Ctrl-C or an error ends it that may pass or be mended."""
        try:
            yield
        except (ResumeError, LeaseLostError):
            raise
        except StudyError:
            again = self.resume_command(run)
            console.print(f"once that is mended, what failed is tried again with:  {again}")
            raise
        except (KeyboardInterrupt, NufleetError, OSError):
            console.print(f"it can be resumed where it stopped:  {self.resume_command(run)}")
            raise
