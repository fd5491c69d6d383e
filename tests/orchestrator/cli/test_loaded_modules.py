"""What commands load: no more than they need, since loading is most of what a short one does."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
from run_records import NOON, a_record

from nufleet.orchestrator.history.report_page import leave_report
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.headline import Headline, write_headline

HEAVY = {
    *("zenoh", "sqlalchemy", "alembic", "psycopg"),
    *("rerun", "matplotlib", "pyarrow", "numba", "torch", "mujoco", "crazyflow"),
}
FIRST_RUN = f"{NOON:%Y%m%dT%H%M%SZ}-lab"
SCRIPT = """
import sys
from nufleet.shared.command_line import main
try:
    main()
finally:
    print(*sys.modules, sep="\\n", file=open("loaded.txt", "w"))
"""


@pytest.fixture
def workplace(tmp_path: Path) -> Path:
    """A folder with the files that the commands read."""
    models = {"first": {"num": [1], "den": [1, 1]}, "second": {"num": [2], "den": [1, 2]}}
    for name, model in models.items():
        (tmp_path / f"{name}.json").write_text(json.dumps(model))
    (tmp_path / "measured.csv").write_text("omega_rad_s,real,imag\n1,1,0\n2,0.5,-0.5\n")
    (tmp_path / "runs").mkdir()
    with RunFolder(tmp_path / "runs", "lab", now=NOON) as folder:
        folder.write_configuration({"kind": "rank", "fleet": "lab"})
        folder.write_record(a_record(folder.path))
        folder.recording.write_bytes(b"RRF2")
    leave_report(folder.path)
    with RunFolder(tmp_path / "runs", "lab", now=NOON) as interrupted:
        interrupted.write_configuration({"kind": "rank", "fleet": "lab"})
    write_headline(interrupted.path, Headline())
    (tmp_path / "runs" / "nufleet.sqlite").touch()
    return tmp_path


def loaded_by(workplace: Path, *arguments: str) -> tuple[set[str], str]:
    """Run a command without a display; return what it loaded and what it printed."""
    hidden = {"DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET", "NUFLEET_RUNS"}
    done = subprocess.run(
        [sys.executable, "-c", SCRIPT, *arguments],
        cwd=workplace,
        env={name: value for name, value in os.environ.items() if name not in hidden},
        capture_output=True,
        text=True,
    )
    modules = (workplace / "loaded.txt").read_text().split()
    return {module.partition(".")[0] for module in modules}, done.stdout + done.stderr


@pytest.mark.parametrize(
    ("arguments", "prints", "also_unneeded"),
    [
        (("gap", "first.json", "second.json"), "guarantee", {"scipy"}),
        (("gap", "first.json", "measured.csv"), "lower bound", {"scipy"}),
        (("view", FIRST_RUN), "no display", {"scipy", "numpy", "pydantic", "rich"}),
        (("runs", "list"), "source-1 for target", {"scipy", "numpy", "pydantic"}),
        (("runs", "list"), "interrupted", {"scipy", "numpy", "pydantic"}),
        (("drawing", "list"), "clover", set[str]()),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_what_only_reads_and_calculates_loads_neither_network_nor_repository(
    workplace: Path, arguments: tuple[str, ...], prints: str, also_unneeded: set[str]
) -> None:
    loaded, said = loaded_by(workplace, *arguments)
    assert prints in said
    assert not loaded & (HEAVY | also_unneeded)


@pytest.mark.parametrize("command", [(), ("rank",), ("evaluate",), ("drawing", "import")])
def test_help_loads_nothing_but_the_words(workplace: Path, command: tuple[str, ...]) -> None:
    loaded, said = loaded_by(workplace, *command, "--help")
    assert said.startswith("Usage: ")
    assert not loaded & (HEAVY | {"numpy", "scipy", "rich", "pydantic"})


@pytest.mark.parametrize(
    ("loading", "unneeded"),
    [
        (
            "import nufleet.robot_agent.serve, nufleet.sims.drivers",
            HEAVY - {"zenoh"} | {"scipy"},
        ),
        (
            "import nufleet.orchestrator.jobs.rank, nufleet.shared.arrays as a; a.arrow()",
            HEAVY - {"zenoh", "sqlalchemy", "pyarrow"} | {"pandas", "scipy.optimize"},
        ),
    ],
    ids=["agent", "rank"],
)
def test_what_moves_robots_loads_only_what_it_needs_until_then(
    loading: str, unneeded: set[str]
) -> None:
    script = f"import sys; {loading}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    modules = set(done.stdout.split())
    assert not (modules | {module.partition(".")[0] for module in modules}) & unneeded
