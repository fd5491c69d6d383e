"""The import directions that keep the parts apart."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = {"shared", "robot_agent", "orchestrator", "sims"}
ALLOWED = {
    "shared": set[str](),
    "robot_agent": {"shared"},
    "orchestrator": {"shared"},
    "sims": {"shared", "robot_agent.robot"},
}
FILES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def imported_modules(path: Path) -> set[str]:
    modules: set[str] = set()
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            modules |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            modules |= {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)}
    return modules


def is_allowed(module: str, package: str) -> bool:
    top = module.partition(".")[0]
    if top not in PACKAGES or top == package:
        return True
    return any(
        module == allowed or module.startswith(f"{allowed}.") or f"{module}." == f"{allowed}."
        for allowed in ALLOWED[package]
    ) or any(allowed.startswith(f"{module}.") for allowed in ALLOWED[package] if "." in allowed)


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_a_module_imports_only_what_its_package_may(path: Path) -> None:
    package = path.relative_to(ROOT).parts[0]
    wrong = {module for module in imported_modules(path) if not is_allowed(module, package)}
    assert not wrong


def test_zenoh_is_imported_by_the_transport_alone() -> None:
    importers = {
        str(path.relative_to(ROOT))
        for path in FILES
        if any(module.partition(".")[0] == "zenoh" for module in imported_modules(path))
    }
    assert importers == {"shared/transport.py"}


def test_nothing_unpickles() -> None:
    unsafe = {"pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib"}
    importers = {
        str(path.relative_to(ROOT))
        for path in FILES
        if any(module.partition(".")[0] in unsafe for module in imported_modules(path))
    }
    assert not importers
