"""How the command begins: a stop before all other programs, and an end in one line."""

from __future__ import annotations

import os
import sys

import pytest

from nufleet import __main__ as command
from nufleet.shared import command_line


class RanError(Exception):
    """The command line has been run."""


@pytest.fixture
def priorities(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    asked: list[int] = []

    def run() -> None:
        raise RanError

    monkeypatch.setattr(command_line, "main", run)
    monkeypatch.setattr(os, "setpriority", lambda _which, _who, priority: asked.append(priority))
    return asked


@pytest.mark.parametrize(
    ("words", "first"),
    [
        (["stop", "--all"], True),
        (["-v", "stop", "a"], True),
        (["rank", "--target", "stop"], False),
        ([], False),
    ],
)
def test_a_stop_alone_asks_to_run_first(
    words: list[str], first: bool, priorities: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys, "argv", ["nufleet", *words])
    with pytest.raises(RanError):
        command.main()
    assert priorities == [command.FIRST] * first


@pytest.mark.usefixtures("priorities")
def test_a_system_that_grants_no_priority_keeps_no_robot_from_being_stopped(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(_which: int, _who: int, _priority: int) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "setpriority", refuse)
    monkeypatch.setattr(sys, "argv", ["nufleet", "stop", "--all"])
    with pytest.raises(RanError):
        command.main()


@pytest.mark.usefixtures("priorities")
def test_ctrl_c_before_the_command_is_loaded_ends_it_in_one_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(_which: int, _who: int, _priority: int) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(os, "setpriority", interrupt)
    monkeypatch.setattr(sys, "argv", ["nufleet", "stop", "--all"])
    with pytest.raises(SystemExit) as ended:
        command.main()
    assert ended.value.code == 130
    assert capsys.readouterr().err == "interrupted\n"
