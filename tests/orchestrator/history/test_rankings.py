"""The latest ranking of a target: in a folder of runs, or in a repository that others share."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from run_records import NOON, a_record

from nufleet.orchestrator.history.rankings import latest_ranking
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.study.interface import StudyPlan


@pytest.fixture
def repository(tmp_path: Path) -> Iterator[Repository]:
    with open_repository(str(tmp_path / "shared.sqlite")) as opened:
        yield opened


def in_folder(root: Path, hour: int) -> str:
    with RunFolder(root, "lab", now=NOON.replace(hour=hour)) as folder:
        folder.write_configuration({"fleet": "lab"})
        folder.write_record(a_record(folder.path))
    return folder.study_id


def in_repository(
    repository: Repository,
    hour: int,
    fleet: str = "lab",
    target: str = "target",
    result: dict[str, object] | None = None,
) -> str:
    study_id = f"20260102t{hour:02}0000z-{fleet}"
    plan = StudyPlan(target, ("source-1",), (0.1, 10.0), 3, "x")
    repository.studies.begin(StudyRecord(study_id, fleet, "adaptive", plan, 0))
    repository.studies.end(study_id, StudyStatus.COMPLETE, "sure enough", result)
    return study_id


RESULT: dict[str, object] = json.loads(a_record(Path("elsewhere")).result.document())


@pytest.mark.parametrize(("folder", "stored"), [(9, 10), (10, 9), (None, 9), (9, None)])
def test_the_newest_is_found_wherever_it_is(
    tmp_path: Path, repository: Repository, folder: int | None, stored: int | None
) -> None:
    found = {}
    if folder is not None:
        found[folder] = in_folder(tmp_path, folder)
    if stored is not None:
        found[stored] = in_repository(repository, stored, result=RESULT)
    ranking = latest_ranking(tmp_path, repository.studies, "lab", "target")
    assert ranking is not None
    assert ranking.run.lower() == found[max(found)]
    assert ranking.result.selected == "source-1"


def test_only_rankings_of_that_target_and_fleet_count(
    tmp_path: Path, repository: Repository
) -> None:
    in_repository(repository, 9, fleet="attic", result=RESULT)
    in_repository(repository, 10, target="source-1", result=RESULT)
    in_repository(repository, 11)  # one of an evaluation's repeated studies
    assert latest_ranking(tmp_path, repository.studies, "lab", "target") is None


def test_a_result_that_no_ranking_prints_is_an_error_that_names_the_study(
    tmp_path: Path, repository: Repository
) -> None:
    study_id = in_repository(repository, 9, result={**RESULT, "selected": 3})
    with pytest.raises(DamagedRecordError, match=f"{study_id}.*nufleet rank --target target"):
        latest_ranking(tmp_path, repository.studies, "lab", "target")
