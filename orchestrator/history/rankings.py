"""The latest ranking of a target, in the folders of runs or in the repository."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from nufleet.orchestrator.history.catalogue import latest_ranking as latest_in_folders
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.runs.folder import study_id_of
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.shared.strict import validation_errors_as

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.study_store import StudyStore


class Ranking(NamedTuple):
    """A completed ranking."""

    run: str
    """Name of its run's folder, or the id of its study; both begin with the time it began at."""
    result: RankResult
    """Document that it printed."""


def latest_ranking(root: Path, studies: StudyStore, fleet: str, target: str) -> Ranking | None:
    """Return the newest completed ranking for a target; None if there is none.

    The repository also holds the rankings of orchestrators that share it, and whose folders of runs
    are elsewhere. The folders also hold rankings that were stored in other repositories.

    Args:
        root: Folder of all runs.
        studies: Store of the repository's studies.
        fleet: Name of the fleet; robots of another fleet may have the same names.
        target: Name of the target.

    Raises:
        InvalidInputError: A newer run in a folder, which may be that ranking, cannot be read.
        DamagedRecordError: The stored result is not one that a ranking prints.
    """
    stored = _latest_stored(studies, fleet, target)
    found = latest_in_folders(root, fleet, target)
    if found is None:
        return stored
    kept = Ranking(found[0].name, found[1].result)
    if stored is None or stored.run <= study_id_of(found[0]):
        return kept
    return stored


def _latest_stored(studies: StudyStore, fleet: str, target: str) -> Ranking | None:
    for study in reversed(studies.studies(StudyStatus.COMPLETE)):
        # Evaluations repeat a study many times; these have no result of their own.
        if (study.fleet, study.plan.target) == (fleet, target) and study.result is not None:
            what = f"the result of study {study.study_id}"
            advice = f"; rank again with `nufleet rank --target {target}`"
            with validation_errors_as(DamagedRecordError, what, advice):
                result = RankResult.model_validate_json(json.dumps(dict(study.result)))
            return Ranking(study.study_id, result)
    return None
