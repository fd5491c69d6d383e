"""How a run reached its fleet, as it is stored: without secrets, and reached again all the same."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from nufleet.orchestrator.fleet.reach import REACH, Reach
from nufleet.orchestrator.runs.console import stderr_console
from nufleet.orchestrator.runs.folder import CONFIGURATION, RunFolder
from nufleet.shared.errors import InvalidInputError

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
        stored.connection(stderr_console())
