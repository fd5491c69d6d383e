"""Which tests are pure: they start no process, open no connection and run no foreign simulator.

It is told from what a module imports, itself or through the tests' own helpers and the conftest.py
of its folders, so that no test has to say it of itself.
"""

from __future__ import annotations

import ast
from collections.abc import Iterator
from functools import cache
from pathlib import Path

TESTS = Path(__file__).parent

REACHING_OUT = (
    *("multiprocessing", "psutil", "psycopg", "socket", "subprocess", "urllib.request", "zenoh"),
    *("gymnasium", "jax", "mujoco", "nufleet.sims.arms", "nufleet.sims.quadrotors", "torch"),
    *(
        "benchmarks",
        "nufleet.orchestrator.fleet.client",
        "nufleet.orchestrator.viewer",
        "nufleet.robot_agent.agent",
    ),
    "cflib",
    "nufleet.sims.crazyflies.peer",
    "nufleet.shared.wire.session",
    "nufleet.shared.wire.transport",
)


def is_pure(path: Path) -> bool:
    """Return whether a test module is pure, without importing it."""
    folders = [folder for folder in path.parents if TESTS in folder.parents]
    conftests = [conftest for folder in folders if (conftest := folder / "conftest.py").exists()]
    return not any(_reaches_out(module) for module in _modules(path, *conftests))


def _modules(*paths: Path) -> set[Path]:
    """Return modules with all helpers that they import, and that those import."""
    found: set[Path] = set()
    new = set(paths)
    while new:
        found |= new
        named = {_helpers().get(name) for path in new for name in _imported(path)}
        new = {path for path in named if path is not None} - found
    return found


def _reaches_out(path: Path) -> bool:
    return any(f"{name}.".startswith(f"{bad}.") for name in _imported(path) for bad in REACHING_OUT)


@cache
def _helpers() -> dict[str, Path]:
    return {path.stem: path for path in TESTS.rglob("*.py") if path.stem != "conftest"}


@cache
def _imported(path: Path) -> frozenset[str]:
    return frozenset(_names(ast.parse(path.read_text())))


def _names(tree: ast.Module) -> Iterator[str]:
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            yield from (f"{node.module}.{alias.name}" for alias in node.names)
            yield node.module
