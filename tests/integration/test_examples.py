"""The examples: a notebook, and the program with which it and the page for Python begin."""

from __future__ import annotations

import io
import json
from collections import Counter
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from counted_fleet import Counted
from page_blocks import ROOT, blocks, difference

EXAMPLES = ROOT / "examples"
PAGE = blocks(ROOT / "docs" / "python.md")
LEARNING = Counter(["target", "source-1", "source-2", "source-3", "target"])
"""The target is described a second time, since its tests have taught it something of itself."""


def cells_of(notebook: Path) -> list[str]:
    """The programs of a notebook, which is kept without their outputs."""
    cells = [cell for cell in json.loads(notebook.read_text())["cells"] if "outputs" in cell]
    assert not [cell for cell in cells if cell["outputs"]]
    return ["".join(cell["source"]) + "\n" for cell in cells]


def test_the_program_of_the_page_the_notebook_and_the_example_is_the_same_in_ten_lines() -> None:
    program = (EXAMPLES / "rank.py").read_text().partition("\n\n")[2]
    first, *_ = cells_of(EXAMPLES / "ranking.ipynb")
    assert first == PAGE[0].code == program
    assert len([line for line in program.splitlines() if line]) <= 10


def test_the_notebook_runs_prints_nothing_by_itself_and_describes_no_robot_in_vain(
    counted: Counted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    mpl.use("Agg")
    names: dict[str, object] = {}
    printed, said = list[str](), io.StringIO()
    for cell in cells_of(EXAMPLES / "ranking.ipynb"):
        with redirect_stdout(io.StringIO()) as out, redirect_stderr(said):
            exec(cell, names)  # noqa: S102 - our own
        printed.append(out.getvalue())
    assert said.getvalue() == ""
    assert counted == Counted(1, LEARNING)
    assert len(plt.get_fignums()) == 2
    plt.close("all")
    ranked, certain, _, verdicts, files = printed
    assert difference(PAGE[1].code, ranked) is None
    assert certain.splitlines()[-1].startswith("source-2 is the closest")
    assert [line.split(":")[0] for line in verdicts.splitlines()] == [
        *("source-2", "source-1", "source-3")
    ]
    assert {"report.html", "ranking.csv", "run.rrd"} <= set(files.split())
