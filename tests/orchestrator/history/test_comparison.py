"""Two runs side by side: settings that differ, and numbers that both have."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from kept_runs import leave

from nufleet.orchestrator.cli.runs import compare
from nufleet.orchestrator.history.catalogue import Run, read_run
from nufleet.orchestrator.history.comparison import compare_runs
from nufleet.shared.errors import InvalidInputError


def two(root: Path, kind: str) -> tuple[Run, Run]:
    return read_run(leave(root, kind)), read_run(leave(root, kind))


def test_settings_that_differ_are_named_wherever_they_are(tmp_path: Path) -> None:
    first = {"seed": 1, "plan": {"iterations": 7, "axis": "x"}, "command": ["a"], "runs_root": "a"}
    second = {"seed": 1, "plan": {"iterations": 2, "axis": "x"}, "command": ["b"], "live": True}
    found = compare_runs(*two(tmp_path, "rank"), (first, second))
    assert [(one.name, one.first, one.second) for one in found.settings] == [
        ("plan.iterations", 7, 2)
    ]


def test_sources_that_both_ranked_are_compared_with_their_uncertainty(tmp_path: Path) -> None:
    found = compare_runs(*two(tmp_path, "rank"), ({}, {}))
    (source,) = found.psi
    assert (source.what, source.first, source.second) == ("source-1", 0.07, 0.07)
    assert source.spread == pytest.approx(0.0025 * 2**0.5)
    assert found.rms == ()


@pytest.mark.parametrize("kind", ["track", "evaluate"])
def test_flights_along_the_same_path_are_compared(tmp_path: Path, kind: str) -> None:
    found = compare_runs(*two(tmp_path, kind), ({}, {}))
    assert found.psi == ()
    assert "target with near on clover at 0.6/s" in {one.what for one in found.rms}
    assert all(one.first == one.second for one in found.rms)


def test_a_run_that_did_not_end_cannot_be_compared(tmp_path: Path) -> None:
    ended, open_run = leave(tmp_path, "rank"), leave(tmp_path, "rank", ended=False)
    with pytest.raises(InvalidInputError, match="has no result to compare: it did not end"):
        compare_runs(read_run(ended), read_run(open_run), ({}, {}))


def test_the_command_prints_tables_or_one_document(tmp_path: Path) -> None:
    first, second = leave(tmp_path, "rank"), leave(tmp_path, "rank")
    said = CliRunner().invoke(compare, [first.name, "latest", "--runs", str(tmp_path)])
    assert said.exit_code == 0, said.exception
    for words in (first.name, second.name, "all settings are the same", "+0.0000"):
        assert words in said.stdout
    arguments = [first.name, second.name, "--json", "--runs", str(tmp_path)]
    document = json.loads(CliRunner().invoke(compare, arguments).stdout)
    assert (document["schema"], document["first"]) == (1, first.name)
