"""What is built is what is used: a wheel that holds nufleet alone, and needs no checkout."""

from __future__ import annotations

import json
import os
import site
import subprocess
import sys
import venv
import zipfile
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
ROOMS = ("shared", "orchestrator", "robot_agent", "sims")
PATIENCE_S = 600.0


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    build = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
    subprocess.run([*build, "--wheel-dir", folder, ROOT], check=True, timeout=PATIENCE_S)
    (built,) = folder.glob("nufleet-*.whl")
    return built


@pytest.fixture(scope="module")
def environment(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An environment that has nufleet from the wheel alone, and borrows what nufleet depends on."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False)
    python = folder / "bin" / "python"
    install = [sys.executable, "-m", "pip", "--python", python, "install", "--quiet", "--no-deps"]
    subprocess.run([*install, wheel], check=True, timeout=PATIENCE_S)
    (packages,) = folder.glob("lib/python*/site-packages")
    # A folder that a .pth file names is searched last, and its own .pth files, by which the
    # checkout is found, are not read.
    (packages / "dependencies.pth").write_text("\n".join(site.getsitepackages()))
    return folder


def test_the_wheel_holds_nufleet_and_its_licence_alone(wheel: Path) -> None:
    names = zipfile.ZipFile(wheel).namelist()
    assert {name.split("/")[0].split("-")[0] for name in names} == {"nufleet"}
    assert "nufleet/py.typed" in names
    here = {str(p.relative_to(ROOT)) for room in ROOMS for p in (ROOT / room).rglob("*.py")}
    assert {f"nufleet/{path}" for path in here} <= set(names)
    assert any(name.endswith("licenses/LICENSE") for name in names)
    # `robot new` writes a test from a template, which is text here.
    assert not [n for n in names if ("/tests/" in n and n.endswith(".py")) or n.endswith(".pyc")]


def test_a_fleet_is_ranked_from_the_wheel_outside_the_checkout(
    environment: Path, tmp_path: Path
) -> None:
    nufleet = environment / "bin" / "nufleet"
    own = {key: value for key, value in os.environ.items() if not key.startswith("PYTHON")}
    ranked = subprocess.run(
        [nufleet, "rank", "--fleet", "paper_linear", "--no-rehearsal", "--no-recording", "--json"],
        cwd=tmp_path,
        env=own,
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert ranked.returncode == 0, ranked.stderr
    assert json.loads(ranked.stdout)["selected"] == "source-2"


@pytest.mark.parametrize("old_name", ROOMS)
def test_no_other_name_is_taken_from_the_environment(environment: Path, old_name: str) -> None:
    code = f"import nufleet.{old_name}, importlib.util as u; print(u.find_spec({old_name!r}))"
    found = subprocess.run(
        [environment / "bin" / "python", "-I", "-c", code],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
    )
    assert found.stdout.strip() == "None", found.stderr
