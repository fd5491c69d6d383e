"""`nufleet runs prune`: what it deletes, and what stays."""

from __future__ import annotations

import json
from datetime import timedelta
from pathlib import Path

import pytest
from run_records import NOON, a_record

from nufleet.orchestrator.jobs.prune import PruneCommand, prune_and_print
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.repository.study_store import StudyStore
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.shared.errors import InvalidInputError

OLD, INTERRUPTED, NEW = "20260102T120000Z-lab", "20260103T120000Z-lab", "20260104T120000Z-lab"


@pytest.fixture
def runs(tmp_path: Path) -> Path:
    """Three runs, the second of which was interrupted, and a link to a folder of another user."""
    root = tmp_path / "runs"
    root.mkdir()
    for number in range(3):
        with RunFolder(root, "lab", now=NOON + timedelta(days=number)) as folder:
            folder.write_configuration({"kind": "rank", "fleet": "lab"})
            folder.recording.write_bytes(bytes(1000))
            (folder.path / "plots").mkdir()
            (folder.path / "plots" / "psi.png").write_bytes(b"png")
            if number != 1:
                folder.write_record(a_record(folder.path))
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "elsewhere" / "config.json").write_text("{}")
    (root / "20260101T120000Z-link").symlink_to(tmp_path / "elsewhere")
    return root


@pytest.fixture
def forgotten(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    found: list[str] = []
    monkeypatch.setattr(StudyStore, "forget_samples", lambda _, run_id: found.append(run_id) or 3)
    return found


def names(runs: Path) -> set[str]:
    return {path.name for path in runs.iterdir() if path.is_dir() and not path.is_symlink()}


def test_nothing_is_deleted_before_it_was_listed(
    runs: Path, forgotten: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    prune_and_print(PruneCommand(runs_root=runs, most=2))
    said = capsys.readouterr().err
    assert OLD in said
    assert "would be deleted: 1 of 3 runs" in said
    assert "--delete" in said
    assert names(runs) == {OLD, INTERRUPTED, NEW}
    assert forgotten == []


def test_runs_go_with_their_samples_but_not_one_that_may_go_on(
    runs: Path, forgotten: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    prune_and_print(PruneCommand(runs_root=runs, most=0, delete=True, as_json=True))
    document = json.loads(capsys.readouterr().out)
    assert [Path(run["run"]).name for run in document["runs"]] == [OLD, NEW]
    assert document["runs"][0]["size_bytes"] > 1000
    assert (document["deleted"], document["samples"]) == (True, 6)
    assert names(runs) == {INTERRUPTED}
    assert forgotten == [OLD.lower(), NEW.lower()]
    assert (runs.parent / "elsewhere" / "config.json").exists()


def test_samples_can_stay_where_only_pictures_take_room(runs: Path, forgotten: list[str]) -> None:
    prune_and_print(PruneCommand(runs_root=runs, most=0, delete=True, keep_samples=True))
    assert names(runs) == {OLD, INTERRUPTED, NEW}
    assert {path.name for path in (runs / OLD).iterdir()} == {"config.json", "results.json"}
    assert (runs / INTERRUPTED / "run.rrd").exists()
    assert forgotten == []


def test_a_run_that_a_command_works_on_stays_although_it_has_a_result(
    runs: Path, forgotten: list[str]
) -> None:
    with RunFolder(runs, NEW, goes_on=True):
        prune_and_print(PruneCommand(runs_root=runs, most=0, delete=True))
        assert names(runs) == {INTERRUPTED, NEW}
    prune_and_print(PruneCommand(runs_root=runs, most=0, delete=True))
    assert names(runs) == {INTERRUPTED}


def test_pictures_that_are_gone_already_are_not_deleted_again(
    runs: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = PruneCommand(runs_root=runs, most=0, delete=True, keep_samples=True)
    prune_and_print(command)
    assert "deleted: recordings and plots of 2 of 3 runs" in capsys.readouterr().err
    prune_and_print(command)
    assert "nothing to delete" in capsys.readouterr().err


def test_samples_are_deleted_where_the_run_stored_them(runs: Path, tmp_path: Path) -> None:
    other = tmp_path / "other.sqlite"
    with RunFolder(runs, "else", now=NOON) as folder:
        folder.write_configuration({"kind": "rank", "repository": f"sqlite:///{other}"})
        folder.write_record(a_record(folder.path))
    command = PruneCommand(runs_root=runs, most=0, delete=True)
    with pytest.raises(InvalidInputError, match=r"other.sqlite.*name it with --repository"):
        prune_and_print(command)
    assert folder.path.exists()
    Storage(runs, str(other)).open().close()
    prune_and_print(command)
    assert not folder.path.exists()


def test_an_age_that_no_run_can_have_deletes_none(runs: Path) -> None:
    prune_and_print(PruneCommand(runs_root=runs, days=1e300, delete=True))
    assert names(runs) == {OLD, INTERRUPTED, NEW}
