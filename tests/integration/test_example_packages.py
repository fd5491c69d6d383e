"""The examples of packages: another simulator's robots, and another algorithm."""

from __future__ import annotations

import ast
import tomllib
from pathlib import Path

import pytest

import nufleet
from nufleet.shared.errors import InvalidInputError

EXAMPLES = Path(__file__).parents[2] / "examples"


def test_an_algorithm_of_another_package_ranks_a_fleet(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    package = EXAMPLES / "halving"
    with pytest.raises(InvalidInputError, match="no algorithm 'halving' is installed; there"):
        nufleet.rank("paper_linear", algorithm="halving", runs_root=tmp_path / "runs")
    install(package, tmp_path, monkeypatch)
    found = nufleet.rank(
        "paper_linear",
        algorithm="halving",
        draws=False,
        rehearses=False,
        runs_root=tmp_path / "runs",
    )
    assert [one.robot for one in found.ranking] == ["source-2", "source-1", "source-3"]
    assert [one.tests for one in found.ranking] == [2, 2, 1]  # the furthest was dropped first
    assert found.selected == "source-2"


def install(package: Path, site: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Make a package importable, with its entry points, as pip would."""
    project = tomllib.loads((package / "pyproject.toml").read_text())["project"]
    metadata = site / f"{project['name'].replace('-', '_')}-1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {metadata.name}\n")
    lines = [
        line
        for group, entries in project["entry-points"].items()
        for line in (f"[{group}]", *(f"{name} = {place}" for name, place in entries.items()))
    ]
    (metadata / "entry_points.txt").write_text("\n".join(lines))
    for folder in (site, package):
        monkeypatch.syspath_prepend(folder)


@pytest.mark.parametrize("package", ["halving", "rotorpy_drone"])
def test_packages_of_others_use_what_is_public(package: str) -> None:
    public = {"nufleet", "nufleet.testing", "nufleet.studies"}
    for file in (EXAMPLES / package).rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("nufleet"):
                assert node.module in public, file
                names = __import__(node.module, fromlist=["x"]).__all__
                assert {alias.name for alias in node.names} <= set(names), file


def test_a_robot_of_another_simulator_its_fleet_and_its_test_have_fewer_than_80_lines() -> None:
    package = EXAMPLES / "rotorpy_drone"
    files = [*package.rglob("*.py"), package / "fleet.toml"]
    lines = [line for file in files for line in file.read_text().splitlines() if line.strip()]
    assert len(lines) < 80
