"""What a study prints: how long and how far robots will move, and tables that keep their digits."""

from __future__ import annotations

import io
from pathlib import Path

import pytest
from random_loops import SPEC
from rich.console import Console
from run_records import a_record

from nufleet.orchestrator.jobs.terminal import (
    rehearsal_shown,
    results_console,
    stderr_console,
    stdout_console,
)
from nufleet.orchestrator.runs.console import ConsoleObserver, record_table
from nufleet.orchestrator.study.interface import Question
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation, Tone


def test_a_round_says_how_long_and_how_far_its_robots_move() -> None:
    console = Console(file=io.StringIO(), width=200)
    test = Excitation(axis="x", tones=(Tone(omega_rad_s=2.0),))
    question = Question(1, {"a": test, "b": test})
    ConsoleObserver(console, 7, {"a": SPEC, "b": SPEC}).asked(question)
    assert isinstance(console.file, io.StringIO)
    expected = f"for {duration_s(test, SPEC):.0f} s, within ±{SPEC.axes[0].amplitude_max:g} m"
    assert f"2 robots play 2.000 rad/s {expected}" in console.file.getvalue()


def test_the_table_of_an_adaptive_ranking_stands_beside_what_was_measured(tmp_path: Path) -> None:
    record = a_record(tmp_path)
    headings = [column.header for column in record_table(record).columns]
    assert headings[-2:] == ["closed form", "error"]
    sure = record.result.model_copy(update={"confidence": 0.99})
    table = record_table(record.model_copy(update={"result": sure}))
    measured = next(column for column in table.columns if column.header == "measured, at rad/s")
    assert list(measured.cells) == ["0.0689 at 4.5"]
    assert table.columns[-1].header == "tests"


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
