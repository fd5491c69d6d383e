"""What `nufleet runs` says of every kind of run: ended, interrupted or damaged."""

from __future__ import annotations

import io
import json
from pathlib import Path

import pytest
from kept_runs import ENDED, leave
from rich.console import Console
from run_records import NOON, a_record

from nufleet.orchestrator.evaluation.flight_documents import (
    TRACKING,
)
from nufleet.orchestrator.history.catalogue import (
    KINDS,
    Damaged,
    Run,
    latest_ranking,
    read_run,
    read_runs,
)
from nufleet.orchestrator.history.listing import listed_runs
from nufleet.orchestrator.history.report_page import leave_report
from nufleet.orchestrator.history.tables import run_tables
from nufleet.orchestrator.jobs.run_list import list_and_print
from nufleet.orchestrator.jobs.runs import show_and_print
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.runs.folder import RESULTS, RunFolder, study_id_of
from nufleet.orchestrator.runs.headline import HEADLINE, Headline, write_headline
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.errors import InvalidInputError


@pytest.fixture(autouse=True)
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """No line of a table is broken."""
    monkeypatch.setenv("COLUMNS", "200")


def printed(run: Run) -> str:
    console = Console(file=io.StringIO(), width=160)
    for part in run_tables(run):
        console.print(part)
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_every_kind_has_an_example_here() -> None:
    assert set(ENDED) == set(KINDS)


@pytest.mark.parametrize("kind", ENDED)
def test_a_run_that_ended_is_told_by_what_it_came_to(tmp_path: Path, kind: str) -> None:
    run = read_run(leave(tmp_path, kind))
    assert (run.kind, run.fleet, run.began) == (kind, "lab", NOON)
    _, _, headline, shown = ENDED[kind]
    assert headline in run.headline
    assert shown in printed(run)


@pytest.mark.parametrize("kind", ENDED)
def test_a_run_that_did_not_end_is_shown_as_interrupted(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = leave(tmp_path, kind, ended=False)
    run = read_run(folder)
    assert (run.kind, run.result, run.headline, printed(run)) == (kind, None, "", "")
    show_and_print(tmp_path, folder.name, as_json=False)
    said = capsys.readouterr().out
    assert "interrupted" in said
    assert f"{kind} of fleet lab, begun 2026-01-02 12:00 UTC" in said
    list_and_print(tmp_path, as_json=False)
    assert "interrupted" in capsys.readouterr().out
    show_and_print(tmp_path, folder.name, as_json=True)
    assert json.loads(capsys.readouterr().out)["result"] is None


def test_a_ranking_that_could_not_go_on_is_told_with_the_reason(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    failed, interrupted = (leave(tmp_path, "rank", ended=False) for _ in range(2))
    with open_repository(f"{tmp_path}/nufleet.sqlite") as repository:
        for run in (failed, interrupted):
            plan = StudyPlan("target", ("near",), (0.1, 30.0), 1, "x")
            repository.studies.begin(StudyRecord(study_id_of(run), "lab", "paper", plan, 0))
        repository.studies.end(study_id_of(failed), StudyStatus.FAILED, "the target is gone")
    show_and_print(tmp_path, failed.name, as_json=False)
    assert "failed: the target is gone" in capsys.readouterr().out
    show_and_print(tmp_path, interrupted.name, as_json=False)
    assert "interrupted" in capsys.readouterr().out
    list_and_print(tmp_path, as_json=False)
    assert "the target" in capsys.readouterr().out


@pytest.mark.parametrize("kind", ENDED)
def test_a_run_is_listed_by_its_headline_as_it_is_by_its_results(
    tmp_path: Path, kind: str, capsys: pytest.CaptureFixture[str]
) -> None:
    leave_report(leave(tmp_path, kind))
    (with_headline,) = listed_runs(tmp_path)
    assert with_headline.told
    said = []
    for _ in range(2):
        for as_json in (False, True):
            list_and_print(tmp_path, as_json=as_json)
        said.append(capsys.readouterr().out)
        (with_headline.folder / HEADLINE).unlink(missing_ok=True)
    assert said[0] == said[1]
    assert ENDED[kind][2] in said[0]


def test_a_run_that_kept_its_headline_is_listed_without_the_repository(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    interrupted, failed = (leave(tmp_path, "rank", ended=False) for _ in range(2))
    write_headline(interrupted, Headline())
    write_headline(failed, Headline(failure="the target is gone"))
    (tmp_path / "nufleet.sqlite").write_text("no database")
    list_and_print(tmp_path, as_json=False)
    first, second = (line for line in capsys.readouterr().out.splitlines() if "rank" in line)
    assert "interrupted" in first
    assert "failed: the target is gone" in second


def test_a_run_that_was_killed_between_its_results_and_its_headline_has_ended(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = leave(tmp_path, "rank", ended=False)
    write_headline(folder, Headline())
    with RunFolder(tmp_path, folder.name, goes_on=True) as again:
        again.write_record(a_record(folder))
    list_and_print(tmp_path, as_json=False)
    assert "source-1 for target" in capsys.readouterr().out


def test_a_list_holds_all_kinds_and_what_is_wrong_with_the_damaged(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind in ENDED:
        leave(tmp_path, kind)
    broken = leave(tmp_path, "track")
    (broken / TRACKING).write_text('{"schema": 2}')
    newer = leave(tmp_path, "train")
    (newer / "config.json").write_text('{"kind": "swarm"}')
    found = read_runs(tmp_path)
    assert {run.kind for run in found if isinstance(run, Run)} == set(ENDED)
    reasons = {run.folder: run.reason for run in found if isinstance(run, Damaged)}
    assert set(reasons) == {broken, newer}
    assert "schema" in reasons[broken]
    assert "'swarm'" in reasons[newer]
    list_and_print(tmp_path, as_json=True)
    listed = json.loads(capsys.readouterr().out)["runs"]
    assert len(listed) == len(found)
    assert {entry.get("kind") for entry in listed} == {*ENDED, None}
    ranked = next(entry for entry in listed if entry.get("kind") == "rank")
    assert ranked["result"]["selected"] == "source-1"
    list_and_print(tmp_path, as_json=False)
    said = capsys.readouterr().out
    assert "swarm" in said


def test_the_document_that_is_shown_is_the_one_that_the_run_left(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for kind, (_, name, *_) in ENDED.items():
        folder = leave(tmp_path, kind)
        show_and_print(tmp_path, folder.name, as_json=True)
        assert json.loads(capsys.readouterr().out) == json.loads((folder / name).read_text())


def test_a_folder_of_before_fleets_were_noted_is_told_by_its_name(tmp_path: Path) -> None:
    folder = leave(tmp_path, "rank")
    (folder / "config.json").write_text('{"kind": "rank"}')
    assert read_run(folder).fleet == "lab"
    (folder / "config.json").write_text("[]")
    with pytest.raises(InvalidInputError, match="expected an object"):
        read_run(folder)


def test_a_copied_folder_of_another_name_has_no_time(tmp_path: Path) -> None:
    folder = leave(tmp_path, "rank").rename(tmp_path / "copied")
    run = read_run(folder)
    assert run.began is None
    assert run.result is not None


def ranked(root: Path, fleet: str, hour: int, *, ended: bool = True) -> Path:
    """Leave a ranking of the robot `target` of a fleet."""
    with RunFolder(root, fleet, now=NOON.replace(hour=hour)) as folder:
        folder.write_configuration({"fleet": fleet})
        if ended:
            folder.write_record(a_record(folder.path))
    return folder.path


def test_the_latest_ranking_is_the_newest_that_ended_of_that_fleet(tmp_path: Path) -> None:
    ranked(tmp_path, "lab", 9)
    newest = ranked(tmp_path, "lab", 10)
    ranked(tmp_path, "lab", 11, ended=False)
    ranked(tmp_path, "attic", 12)
    found = latest_ranking(tmp_path, "lab", "target")
    assert found is not None
    folder, record = found
    assert (folder, record.result.selected) == (newest, "source-1")


def test_robots_of_the_same_name_in_another_fleet_have_no_ranking(tmp_path: Path) -> None:
    ranked(tmp_path, "lab", 9)
    assert latest_ranking(tmp_path, "attic", "target") is None
    assert latest_ranking(tmp_path, "lab", "source-1") is None


def test_a_damaged_ranking_is_not_passed_over_for_an_older_one(tmp_path: Path) -> None:
    ranked(tmp_path, "lab", 9)
    newest = ranked(tmp_path, "lab", 10)
    (newest / RESULTS).write_text("{}")
    with pytest.raises(InvalidInputError, match=newest.name):
        latest_ranking(tmp_path, "lab", "target")


def test_a_run_is_shown_as_running_for_as_long_as_a_command_works_on_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with RunFolder(tmp_path, "lab", now=NOON) as folder:
        folder.write_configuration({"kind": "rank", "fleet": "lab"})
        show_and_print(tmp_path, folder.path.name, as_json=False)
        assert "it is still running" in capsys.readouterr().out
    show_and_print(tmp_path, folder.path.name, as_json=False)
    assert "it was interrupted before anything moved" in capsys.readouterr().out


def test_a_run_that_is_kept_elsewhere_is_resumed_from_there(tmp_path: Path) -> None:
    beside = {"runs_root": "runs", "repository": "sqlite:///runs/nufleet.sqlite"}
    assert Storage.of_run(tmp_path, beside) == Storage(tmp_path)
    elsewhere = {"runs_root": "runs", "repository": f"sqlite:///{tmp_path}/lab.sqlite"}
    storage = Storage.of_run(tmp_path, elsewhere)
    assert storage.resume_command("run").endswith(f"--repository sqlite:///{tmp_path}/lab.sqlite")
    assert storage.lacks("run")
