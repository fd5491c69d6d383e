"""What a run came to in one line: believed only where it fits what lies in the folder."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from nufleet.orchestrator.runs.folder import CONFIGURATION
from nufleet.orchestrator.runs.headline import HEADLINE, Headline, read_headline, write_headline

ENDED = Headline("source-1 for target", "results.json")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    (tmp_path / CONFIGURATION).write_text("{}")
    return tmp_path


def test_a_headline_comes_back_as_long_as_the_results_are_the_same(run: Path) -> None:
    (run / "results.json").write_text("[1]")
    write_headline(run, ENDED)
    assert read_headline(run) == ENDED
    (run / "results.json").write_text("[2]")
    assert read_headline(run) is None
    (run / "results.json").unlink()
    assert read_headline(run) is None


@pytest.mark.parametrize("headline", [Headline(), Headline(failure="the target is gone")])
def test_a_run_is_believed_to_have_no_results_until_it_has_some(
    run: Path, headline: Headline
) -> None:
    write_headline(run, headline)
    assert read_headline(run) == headline
    (run / "evaluation.json").write_text("{}")
    assert read_headline(run) is None


def test_a_run_of_an_older_version_has_none(run: Path) -> None:
    assert read_headline(run) is None


@pytest.mark.parametrize(
    "change",
    [
        {"schema": 2},
        {"text": None},
        {"results": 3},
        {"results": "../results.json"},
        {"results_sha256": 0},
    ],
    ids=str,
)
def test_what_another_program_wrote_is_not_believed(run: Path, change: dict[str, Any]) -> None:
    for folder in (run, run.parent):
        (folder / "results.json").write_text("[1]")
    write_headline(run, ENDED)
    kept = json.loads((run / HEADLINE).read_text())
    (run / HEADLINE).write_text(json.dumps(kept | change))
    assert read_headline(run) is None


@pytest.mark.parametrize("content", ["", "[1]", "{", "[" * 100_000, "\udc80"])
def test_what_is_no_headline_is_not_believed(run: Path, content: str) -> None:
    (run / HEADLINE).write_text(content, errors="surrogateescape")
    assert read_headline(run) is None


def test_a_headline_from_elsewhere_cannot_control_the_terminal(run: Path) -> None:
    write_headline(run, Headline(failure="gone\x1b[2J"))
    assert read_headline(run) == Headline(failure="gone?[2J")
