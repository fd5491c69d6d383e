"""What a study prints: how long and how far robots will move, and tables that keep their digits."""

from __future__ import annotations

import io

import pytest
from random_loops import SPEC
from rich.console import Console

from nufleet.orchestrator.jobs.terminal import (
    bars_shown,
    rehearsal_shown,
    results_console,
    stderr_console,
    stdout_console,
)
from nufleet.orchestrator.runs.console import ConsoleObserver
from nufleet.orchestrator.study.interface import Question
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation, Tone


@pytest.mark.parametrize(("names", "robots"), [("a", "1 robot is"), ("ab", "2 robots are")])
@pytest.mark.parametrize("amplitude", [None, 0.0125])
def test_a_round_says_how_long_and_how_far_its_robots_move(
    names: str, robots: str, amplitude: float | None
) -> None:
    console = Console(file=io.StringIO(), width=200)
    test = Excitation(axis="x", tones=(Tone(omega_rad_s=2.0),), amplitude=amplitude)
    question = Question(1, dict.fromkeys(names, test))
    ConsoleObserver(console, 7, dict.fromkeys(names, SPEC)).asked(question)
    assert isinstance(console.file, io.StringIO)
    furthest_m = amplitude or SPEC.axes[0].amplitude_max
    within = f"{duration_s(test, SPEC):.0f} s long and within ±{furthest_m:g} m"
    assert f"{robots} asked to play 2.000 rad/s, {within}" in console.file.getvalue()


def test_a_narrow_terminal_costs_no_digits_and_a_file_has_one_line_per_row(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("COLUMNS", "60")
    assert stdout_console().width == 80
    assert stderr_console().width == 80
    monkeypatch.delenv("COLUMNS")
    assert stdout_console().width >= 1000


def test_results_go_to_stdout_unless_a_document_or_a_script_takes_them_elsewhere() -> None:
    progress = stderr_console()
    assert not results_console(progress, as_json=False).stderr
    assert results_console(progress, as_json=True) is progress
    given = Console(quiet=True)
    assert results_console(given, as_json=False) is given


def test_a_rehearsal_is_shown_on_a_terminal_alone() -> None:
    for terminal in (True, False):
        console = Console(file=io.StringIO(), force_terminal=terminal, width=100)
        with rehearsal_shown(console) as shown:
            shown(1, 4)
        assert isinstance(console.file, io.StringIO)
        assert ("1/4" in console.file.getvalue()) == terminal


def test_each_piece_of_work_has_a_bar_until_it_is_done() -> None:
    console = Console(file=io.StringIO(), force_terminal=True, width=100)
    with bars_shown(console, "robots") as shown:
        shown("starting", 0, 4)
        shown("training a", 20, 1500)
        shown("starting", 4, 4)
    assert isinstance(console.file, io.StringIO)
    drawn = console.file.getvalue()
    assert "training a" in drawn
    assert "20/1500" in drawn
    assert "4/4" not in drawn
