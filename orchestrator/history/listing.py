"""The list of earlier runs, told by their headlines.

Only runs that kept none are read as a whole, which takes modules that most lists do without.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from nufleet.orchestrator.runs.folder import list_runs, read_configuration, subject_of
from nufleet.orchestrator.runs.headline import Headline, read_headline
from nufleet.shared.errors import InvalidInputError


@dataclass(frozen=True)
class ListedRun:
    """One run of a list."""

    folder: Path
    """Folder of the run."""
    kind: str
    """Kind of the run; empty if it cannot be read."""
    fleet: str
    """Name of the fleet."""
    began: datetime | None
    """Time at which the run began, in UTC; None if the folder's name does not hold it."""
    headline: Headline
    """What the run came to."""
    told: bool = True
    """Whether the run itself kept the headline, so that its reason for a failure is known."""
    damage: str = ""
    """Reason why the run cannot be read; empty if it can."""


def listed_runs(root: Path) -> list[ListedRun]:
    """Return all runs, oldest first.

    Args:
        root: Folder of all runs.
    """
    return [_listed(folder) for folder in list_runs(root)]


def _listed(folder: Path) -> ListedRun:
    try:
        kind, fleet, began = subject_of(folder, read_configuration(folder))
        headline = read_headline(folder)
        if headline is not None:
            return ListedRun(folder, kind, fleet, began, headline)
        return _read(folder)
    except InvalidInputError as error:
        return ListedRun(folder, "", "", None, Headline(), damage=str(error))


def _read(folder: Path) -> ListedRun:
    from nufleet.orchestrator.history.catalogue import KINDS, read_run

    run = read_run(folder)
    results = "" if run.result is None else KINDS[run.kind].document
    headline = Headline(run.headline, results)
    return ListedRun(folder, run.kind, run.fleet, run.began, headline, told=False)
