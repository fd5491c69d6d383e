"""How a run reached its fleet, as it is stored: without secrets, and reached again all the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from rich.console import Console

from nufleet.orchestrator.fleet.reach import REACH, FleetChoice, Reach
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.runs.folder import CONFIGURATION, RunFolder
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import find_fleet_file

FLEET = find_fleet_file("paper_linear")
ENDPOINT = "tls/127.0.0.1:7447#connect_private_key_base64=MIIEvsecret"


def test_the_secrets_of_an_endpoint_and_of_a_repository_are_in_no_configuration(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ("--connect", ENDPOINT, "--repository", "postgresql://me:se/secret@h/d")
    monkeypatch.setattr("sys.argv", ["nufleet", "rank", *words])
    with RunFolder(tmp_path, "lab") as folder:
        folder.write_configuration({REACH: Reach(connect=ENDPOINT).model_dump(mode="json")})
        text = (folder.path / CONFIGURATION).read_text(encoding="utf-8")
    assert "secret" not in text
    document = json.loads(text)
    assert document[REACH]["connect"] == "tls/127.0.0.1:7447#***"
    assert document["command"][-1] == "postgresql://me:***@h/d"


def test_an_endpoint_whose_secrets_were_not_stored_has_to_be_named_again() -> None:
    stored = Reach.model_validate_json(Reach(connect=ENDPOINT).model_dump_json())
    with pytest.raises(InvalidInputError, match="give the whole endpoint with --connect"):
        FleetChoice.again(stored).connection(Console(quiet=True))


def test_the_target_and_the_band_that_were_named_come_before_those_of_the_fleet_file() -> None:
    own, running = FleetChoice.started(FLEET), FleetChoice.running(ENDPOINT, None)
    assert own.target("source-1") == running.target("source-1") == "source-1"
    assert own.band_rad_s((1.0, 2.0)) == running.band_rad_s((1.0, 2.0)) == (1.0, 2.0)
    assert own.file is not None
    assert own.file.study is not None
    assert own.target(None) == own.file.study.target
    assert own.band_rad_s(None) == own.file.study.band_rad_s
    assert running.band_rad_s(None) is None
    with pytest.raises(InvalidInputError, match="Name it with --target"):
        running.target(None)


def test_a_fleet_file_that_names_another_fleet_than_when_the_run_began_is_refused(
    tmp_path: Path,
) -> None:
    file = tmp_path / "fleet.toml"
    file.write_text(FLEET.read_text())
    reach = FleetChoice.started(file).reach.model_copy(update={"fleet_name": "paper-linear"})
    assert FleetChoice.again(reach).file == FleetChoice.started(file).file
    file.write_text(FLEET.read_text().replace("paper-linear", "paper-linear-2"))
    with pytest.raises(InvalidInputError, match=r"is of fleet paper-linear, .* paper-linear-2 now"):
        FleetChoice.again(reach)


def test_a_resumed_run_finds_its_robots_with_what_they_have_learned(tmp_path: Path) -> None:
    one = FLEET.read_text().partition("[robots.source-1]")[0]
    file = tmp_path / "one.toml"
    file.write_text(one)
    choice = FleetChoice.started(file, processes=1).remembering(tmp_path / "robots")
    with choice.connection(Console(quiet=True)) as (fleet, _, _):
        Pilot(fleet, "run").rich("target", duration_s=5.0, seed=0)
        known_s = fleet.describe("target").least_known_s
    assert known_s > 0
    again = Reach.model_validate_json(choice.reach.model_dump_json())
    with FleetChoice.again(again).connection(Console(quiet=True)) as (fleet, _, _):
        assert fleet.describe("target").least_known_s == known_s
