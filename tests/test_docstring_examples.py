"""The examples in docstrings do what they show."""

from __future__ import annotations

import doctest
import re
from importlib import import_module
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# Run here and not by `--doctest-modules`, which would import the modules a second time, under the
# bare names of their folders.
MODULES = [
    ".".join(("nufleet", *path.relative_to(ROOT).with_suffix("").parts))
    for folder in ("orchestrator", "robot_agent", "shared", "sims")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if re.search(r"^\s*>>> ", path.read_text(encoding="utf-8"), flags=re.MULTILINE)
]
MODULES += ["nufleet", "nufleet.testing"]


@pytest.mark.parametrize("module", MODULES)
def test_examples_do_what_they_show(module: str) -> None:
    found = doctest.testmod(import_module(module), optionflags=doctest.NORMALIZE_WHITESPACE)
    assert found.attempted
    assert not found.failed


def test_there_are_examples_of_what_other_programs_use() -> None:
    packages = {module.rpartition(".")[0].removeprefix("nufleet.") for module in MODULES}
    assert {
        "orchestrator.runs",
        "robot_agent",
        "shared.distance",
        "shared.models",
        "shared.paths",
        "shared.robots",
    } <= packages
