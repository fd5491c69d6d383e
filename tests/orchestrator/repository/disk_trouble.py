"""A process on a file system of its own that fills up, or cannot be written any more."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from itertools import count
from pathlib import Path

from repository_records import STUDY, intent

from nufleet.orchestrator.repository.errors import RepositoryError
from nufleet.orchestrator.repository.repository import open_repository


def fill_up(folder: Path) -> str:
    """Store intents until the disk is full, then make room and go on; return the error."""
    ballast = folder / "ballast"
    with open_repository(str(folder / "r.sqlite")) as repository:
        repository.studies.begin(STUDY)
        ballast.write_bytes(bytes(600_000))
        stored = []
        for number in count():
            trial = replace(intent(f"r{number}"), goal_id=f"goal-{number}" + "x" * 5000)
            try:
                repository.studies.intend(trial)
            except RepositoryError as error:
                said = f"{type(error).__name__}: {error}"
                break
            stored.append(trial)
        assert len(stored) > 3
        kept = {record.intent for record in repository.studies.trials(STUDY.study_id)}
        assert kept == set(stored)
        ballast.unlink()
        repository.studies.intend(trial)
    with open_repository(str(folder / "r.sqlite")) as repository:
        kept = {record.intent for record in repository.studies.trials(STUDY.study_id)}
        assert kept == {*stored, trial}
    return said


def read_only(folder: Path) -> str:
    """Open a repository whose file system became read-only; return the error."""
    open_repository(str(folder / "r.sqlite")).close()
    subprocess.run(["mount", "-o", "remount,ro", str(folder)], check=True)
    try:
        open_repository(str(folder / "r.sqlite"))
    except RepositoryError as error:
        return f"{type(error).__name__}: {error}"
    raise AssertionError("a repository that cannot be written was opened")


if __name__ == "__main__":
    scenarios = {"full": fill_up, "read-only": read_only}
    sys.stdout.write(scenarios[sys.argv[2]](Path(sys.argv[1])))
