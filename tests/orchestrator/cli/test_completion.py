"""What the shell is offered to complete what was typed after `nufleet`."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
from click.shell_completion import ShellComplete

from nufleet.orchestrator.runs.folder import CONFIGURATION
from nufleet.shared.command_line import command_line


def offered(line: str) -> list[str]:
    """What is offered for the last word of a line, which may be empty."""
    *args, incomplete = line.split(" ")
    shell = ShellComplete(command_line(), {}, "nufleet", "_NUFLEET_COMPLETE")
    return [item.value for item in shell.get_completions(args, incomplete)]


def test_commands_and_options_are_completed() -> None:
    assert offered("ra") == ["rank"]
    assert "show" in offered("runs ")
    assert offered("rank --prec") == ["--precision"]


def test_installed_fleets_and_drawings_are_completed_and_so_are_files() -> None:
    assert offered("rank --fleet paper_") == ["paper_linear", "paper_quadrotors", "paper_"]
    assert "clover" in offered("rank --trajectory ")
    assert "arms" in offered("fleet up a")


def test_the_robots_of_the_fleet_file_that_was_typed_are_completed() -> None:
    assert offered("rank --fleet paper_linear --target t") == ["target"]
    assert offered("rank --fleet paper_linear --sources source-1,source-") == [
        "source-1,source-2",
        "source-1,source-3",
    ]
    assert offered("rank --fleet nowhere.toml --target t") == []
    assert offered("rank --target t") == []


def test_runs_are_completed_the_newest_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("20260101T000000Z-lab", "20260102T000000Z-lab"):
        (tmp_path / "runs" / name).mkdir(parents=True)
        (tmp_path / "runs" / name / CONFIGURATION).write_text("{}")
    runs = ["20260102T000000Z-lab", "20260101T000000Z-lab"]
    assert offered("runs show ") == ["latest", *runs]
    assert offered("view 2") == runs
    assert offered("runs compare --runs elsewhere 2") == []


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_a_shell_gets_its_script(shell: str) -> None:
    printed = subprocess.run(
        [sys.executable, "-P", "-m", "nufleet", "completion", shell],
        capture_output=True,
        text=True,
        check=True,
    )
    assert "_NUFLEET_COMPLETE" in printed.stdout
