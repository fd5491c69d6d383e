"""The examples, run as a reader would: real processes, in a folder of their own."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_ten_lines_of_python_rank_a_fleet_and_print_nothing_by_themselves(tmp_path: Path) -> None:
    example = EXAMPLES / "rank.py"
    lines = [line for line in example.read_text().splitlines()[1:] if line]
    assert len(lines) <= 10
    ran = subprocess.run(
        [sys.executable, str(example)], capture_output=True, text=True, cwd=tmp_path
    )
    assert ran.returncode == 0, ran.stderr
    assert ran.stderr == ""
    first, *_, chosen, headline = ran.stdout.splitlines()
    assert first.startswith("1. source-2: ψ* 0.0")
    assert chosen.startswith("take source-2's experience")
    assert "source-2" in headline
