"""The page on faults names tests that there are, and quotes messages that are printed."""

from __future__ import annotations

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
ADVICE, FAULTS = (
    (ROOT / "docs" / "faults.md")
    .read_text(encoding="utf-8")
    .split("## Failure modes, and the tests")
)
MESSAGES = re.findall(r"`([^`]+)`", "".join(re.findall(r"^\| (`.*?) \|", ADVICE, re.MULTILINE)))
ROWS = [
    line
    for line in FAULTS.splitlines()
    if line.startswith("| ") and not line.startswith("| fault |")
]


def test_the_messages_for_which_the_page_gives_advice_are_those_of_the_code() -> None:
    packages = ("orchestrator", "robot_agent", "shared")
    files = (path for package in packages for path in (ROOT / package).rglob("*.py"))
    code = "".join(path.read_text(encoding="utf-8") for path in files)
    # A message that takes several lines is quoted as it is printed.
    code = re.sub(r"\"\s*\n\s*f?\"", "", code)
    assert len(MESSAGES) > 15
    assert [message for message in MESSAGES if message not in code] == []


@pytest.mark.parametrize("row", ROWS, ids=[row.split("|")[1].strip() for row in ROWS])
def test_every_fault_is_shown_by_tests_that_exist(row: str) -> None:
    named = re.findall(r"`([\w/]+\.py)::(\w+)`", row)
    assert named
    for file, test in named:
        tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
        assert test in {node.name for node in tree.body if isinstance(node, ast.FunctionDef)}, file


def test_every_test_that_causes_faults_is_in_the_table() -> None:
    text = "\n".join(ROWS)
    own = {path.name for path in Path(__file__).parent.glob("test_*.py")} - {Path(__file__).name}
    assert {name for name in own if name not in text} == set()
