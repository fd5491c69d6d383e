"""What a run leaves on disk, and finding it again."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pyarrow.parquet as pq
import pytest
from run_records import NOON, a_record, a_test

from nufleet.orchestrator.runs.folder import CONFIGURATION as CONFIG
from nufleet.orchestrator.runs.folder import (
    RunFolder,
    find_run,
    list_runs,
    make_runs_root,
    read_record,
)
from nufleet.shared.errors import InvalidInputError


def test_a_record_reads_back_as_it_was_written(tmp_path: Path) -> None:
    with RunFolder(tmp_path, "fleet", now=NOON) as folder:
        folder.write_record(a_record(folder.path))
    assert folder.path.name == "20260102T120000Z-fleet"
    assert read_record(folder.path) == a_record(folder.path)


def test_the_secrets_of_a_fleets_address_are_not_written(tmp_path: Path) -> None:
    address = "tls/127.0.0.1:7447#connect_private_key_base64=MIIEvsecret"
    with RunFolder(tmp_path, "fleet") as folder:
        folder.write_configuration({"kind": "train", "connect": address, "seed": 3})
    text = (folder.path / CONFIG).read_text()
    assert "secret" not in text
    assert json.loads(text)["connect"] == "tls/127.0.0.1:7447#***"


def test_two_runs_in_one_second_get_two_folders(tmp_path: Path) -> None:
    first, second = RunFolder(tmp_path, "f", now=NOON), RunFolder(tmp_path, "f", now=NOON)
    assert first.path != second.path


def test_samples_are_kept_exactly_and_by_robot(tmp_path: Path) -> None:
    tests = [a_test("a"), a_test("b")]
    with RunFolder(tmp_path, "fleet") as folder:
        for measured in tests:
            folder.write_samples(1, measured)
    table = pq.read_table(folder.path / "telemetry.parquet").to_pydict()
    for measured in tests:
        rows = [k for k, robot in enumerate(table["robot"]) if robot == measured.robot]
        response = [table["response"][k] for k in rows]
        assert response == measured.result.response.tolist()
        assert table["t_s"][rows[-1]] == pytest.approx(measured.result.plan.duration_s, abs=0.02)


def test_the_configuration_holds_what_was_asked_and_the_versions(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path, "fleet")
    folder.write_configuration({"kind": "rank", "seed": 3})
    document = json.loads((folder.path / "config.json").read_text())
    assert document["seed"] == 3
    assert {"python", "nufleet", "eclipse-zenoh", "numpy"} <= set(document["versions"])


def test_a_run_is_found_by_path_by_name_and_as_the_latest(tmp_path: Path) -> None:
    older = RunFolder(tmp_path, "older", now=NOON)
    newer = RunFolder(tmp_path, "newer", now=NOON.replace(hour=13))
    for folder in (older, newer):
        folder.write_configuration({})
    assert list_runs(tmp_path) == [older.path, newer.path]
    assert find_run(tmp_path, "latest") == newer.path
    assert find_run(tmp_path, older.path.name) == older.path
    assert find_run(Path("elsewhere"), str(older.path)) == older.path


def test_a_run_that_is_not_there_is_an_error_that_says_where_to_look(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="nufleet runs list"):
        find_run(tmp_path, "nothing")


def test_a_name_that_no_system_accepts_is_an_error_in_words(tmp_path: Path) -> None:
    name = "r" * 300
    with pytest.raises(InvalidInputError, match="cannot be read: File name too long"):
        find_run(tmp_path, name)
    with pytest.raises(InvalidInputError, match="cannot be read: File name too long"):
        read_record(tmp_path / name)


def test_altered_results_are_refused_naming_file_and_field(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path, "fleet")
    folder.write_record(a_record(folder.path))
    path = folder.path / "results.json"
    path.write_text(path.read_text().replace('"seed": 3', '"seed": -3'))
    with pytest.raises(InvalidInputError, match=r"results\.json: seed"):
        read_record(folder.path)


def test_a_place_that_cannot_be_written_is_refused_in_words(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_text("")
    with pytest.raises(InvalidInputError, match="choose another place with --runs"):
        make_runs_root(blocked / "runs")


def test_a_run_is_its_users_alone(tmp_path: Path) -> None:
    root = tmp_path / "runs"
    make_runs_root(root)
    with RunFolder(root, "lab") as folder:
        folder.write_configuration({})
        for path, private in ((root, 0o700), (folder.path, 0o700), (folder.path / CONFIG, 0o600)):
            assert stat.S_IMODE(path.stat().st_mode) == private, path


def test_a_root_that_others_may_look_into_stays_as_its_user_made_it(tmp_path: Path) -> None:
    tmp_path.chmod(0o750)
    make_runs_root(tmp_path)
    assert stat.S_IMODE(tmp_path.stat().st_mode) == 0o750


def test_no_document_is_written_through_a_link(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("somebody's", encoding="utf-8")
    with RunFolder(tmp_path, "lab") as folder:
        for name in (CONFIG, f"{CONFIG}.part"):
            (folder.path / name).symlink_to(victim)
            folder.write_configuration({})
            assert victim.read_text(encoding="utf-8") == "somebody's"
        assert not (folder.path / CONFIG).is_symlink()


def test_estimates_of_earlier_versions_are_read_with_their_intervals(tmp_path: Path) -> None:
    document = json.loads(a_record(tmp_path).model_dump_json(by_alias=True))
    for ranking in (document["result"]["ranking"], document["history"][0]["ranking"]):
        del ranking[0]["psi_low"], ranking[0]["psi_high"]
        ranking[0]["psi_std"] = 0.01
    (tmp_path / "results.json").write_text(json.dumps(document))
    estimate = read_record(tmp_path).result.ranking[0]
    assert (estimate.psi, estimate.psi_low) == pytest.approx((0.07, 0.0504))
    assert estimate.psi_high == pytest.approx(0.0896)
