"""Runs that are interrupted and go on, as a user and as another program see them."""

from __future__ import annotations

import json
import signal
import subprocess
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import psutil
import pytest
from command_processes import PATIENCE_S, Typed, begun, fleet_that_is_up, nufleet, trial_statuses
from polling import wait_until

from nufleet.orchestrator.repository.records import StudyStatus, TrialStatus
from nufleet.orchestrator.repository.repository import open_repository

FLEET = """
schema = 1
name = "lab"

[robots.target]
driver = "double_integrator"
settings = { alpha = 0.85, beta = 0.003 }

[robots.near]
driver = "double_integrator"
settings = { alpha = 0.97, beta = 0.003 }

[robots.far]
driver = "double_integrator"
settings = { alpha = 1.2, beta = 0.003 }
"""
STUDY = (
    *("--target", "target", "--band", "2", "10", "--no-recording"),
    *("--algorithm", "paper", "--iterations", "2", "--seed", "5"),
)
AT_ONCE = ("--no-rehearsal", "--json")
ROBOTS = 3
OWN = ("rank", "--fleet", "paper_linear")


@dataclass(frozen=True)
class Workplace:
    """A fleet that is up, its file, and what an undisturbed ranking of it printed."""

    endpoint: str
    file: Path
    undisturbed: dict[str, object]

    def check(self, document: dict[str, object]) -> None:
        """A ranking that was disturbed is the same, up to where robots came to rest in between."""
        expected, found = self.undisturbed["ranking"], document["ranking"]
        assert isinstance(expected, list)
        assert isinstance(found, list)
        for row, mine in zip(expected, found, strict=True):
            assert (mine["robot"], mine["tests"]) == (row["robot"], row["tests"])
            assert mine["psi"] == pytest.approx(row["psi"], abs=1e-5)


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workplace]:
    folder = tmp_path_factory.mktemp("lab")
    file, endpoint = folder / "lab.toml", f"unixsock-stream/{folder}/r.sock"
    file.write_text(FLEET)
    with fleet_that_is_up(file, endpoint, folder, "--realtime", "10"):
        done = nufleet("rank", "--connect", endpoint, *STUDY, *AT_ONCE, cwd=folder)
        assert done.returncode == 0, done.stderr
        yield Workplace(endpoint, file, json.loads(done.stdout))


def under_way(database: Path) -> bool:
    """Whether some tests have been measured and others are in progress."""
    found = trial_statuses(database)
    return "measured" in found and "accepted" in found[ROBOTS:]


@contextmanager
def under_way_when(database: Path, *arguments: str, cwd: Path) -> Iterator[subprocess.Popen[str]]:
    """A ranking of which some tests are done; processes left over afterwards are killed."""
    with begun(*arguments, cwd=cwd) as process:
        try:
            wait_until(
                lambda: under_way(database) or process.poll() is not None, timeout_s=PATIENCE_S
            )
            assert process.poll() is None
            yield process
        finally:
            process.kill()


def the_run(root: Path) -> Path:
    (run,) = [path for path in root.iterdir() if path.is_dir()]
    return run


def test_a_killed_ranking_goes_on_with_the_robots_that_it_left(
    lab: Workplace, tmp_path: Path, typed: Typed
) -> None:
    database = tmp_path / "runs" / "nufleet.sqlite"
    join = ("rank", "--connect", lab.endpoint)
    with under_way_when(database, *join, *STUDY, cwd=tmp_path) as killed:
        killed.kill()
        killed.communicate()
    run = the_run(tmp_path / "runs")
    assert not (run / "results.json").exists()
    done = typed("rank", "--resume", "latest", *AT_ONCE, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert Path(document["run"]).name == run.name
    lab.check(document)
    assert {path.name for path in run.iterdir()} == {
        *("config.json", "results.json", "telemetry.parquet", "run.rrd", "plots", "report.md"),
        *("report.html", "ranking.csv", "headline.json"),
    }
    with open_repository(str(database)) as repository:
        study = repository.studies.study(run.name.lower())
        kept = repository.studies.trials(study.study_id)
    assert study.status is StudyStatus.COMPLETE
    assert study.result == document
    assert len([t for t in kept if t.status is TrialStatus.MEASURED]) == 2 * ROBOTS
    assert all(t.interrupted for t in kept if t.status is not TrialStatus.MEASURED)
    again = typed("rank", "--resume", run.name, cwd=tmp_path)
    assert again.returncode == 2
    assert "is complete" in again.stderr


def test_a_ranking_that_failed_as_robots_were_stopped_is_tried_again_once_they_are_released(
    lab: Workplace, tmp_path: Path
) -> None:
    database = tmp_path / "runs" / "nufleet.sqlite"
    join = ("rank", "--connect", lab.endpoint)
    with under_way_when(database, *join, *STUDY, cwd=tmp_path) as failing:
        stopped = nufleet("stop", "--all", "--connect", lab.endpoint, cwd=tmp_path)
        assert stopped.returncode == 0, stopped.stderr
        _, said = failing.communicate(timeout=PATIENCE_S)
        assert failing.returncode == 1
    run = the_run(tmp_path / "runs")
    words = " ".join(said.split())
    assert "what failed is tried again with: " in words
    assert f" runs resume {run.name}" in words
    while_stopped = nufleet("runs", "resume", run.name, cwd=tmp_path)
    assert while_stopped.returncode == 1
    for robot in ("target", "near", "far"):
        released = nufleet("release", robot, "--connect", lab.endpoint, cwd=tmp_path)
        assert released.returncode == 0, released.stderr
    done = nufleet("runs", "resume", run.name, *AT_ONCE, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lab.check(json.loads(done.stdout))
    listed = nufleet("runs", "list", cwd=tmp_path)
    assert "failed" not in listed.stdout


def test_ctrl_c_says_how_to_go_on_and_a_fleet_of_its_own_is_started_again(
    lab: Workplace, tmp_path: Path, typed: Typed
) -> None:
    own = ("rank", "--fleet", str(lab.file), *STUDY, "--realtime", "10", "--runs", "here")
    database = tmp_path / "here" / "nufleet.sqlite"
    with under_way_when(database, *own, cwd=tmp_path) as interrupted:
        children = psutil.Process(interrupted.pid).children(recursive=True)
        interrupted.send_signal(signal.SIGINT)
        _, said = interrupted.communicate(timeout=PATIENCE_S)
        psutil.wait_procs(children, timeout=PATIENCE_S)
    assert interrupted.returncode == 130
    run = the_run(tmp_path / "here")
    assert f"runs resume {run.name} --runs here" in said
    # Its successor need not wait: it gave its robots back.
    with open_repository(str(database)) as repository:
        assert not repository.leases.held(f"lab/{run.name.lower()}")
    go_on = ("rank", "--resume", run.name, "--runs", "here")
    clash = typed(*go_on, "--seed", "1", cwd=tmp_path)
    assert clash.returncode == 2
    assert "--seed is already set by the run" in clash.stderr
    done = typed(*go_on, *AT_ONCE, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    lab.check(json.loads(done.stdout))


def test_nothing_to_resume_is_an_error_that_says_what_there_is(
    tmp_path: Path, typed: Typed
) -> None:
    (tmp_path / "runs").mkdir()
    for command in (["runs", "resume"], ["rank", "--resume", "latest"]):
        done = typed(*command, cwd=tmp_path)
        assert done.returncode == 2
        assert "no run in runs was interrupted" in done.stderr


def test_a_repository_that_cannot_be_used_is_refused_before_anything_starts(
    tmp_path: Path, typed: Typed
) -> None:
    for address, words in (
        ("mysql://host/db", "expected a file"),
        (str(tmp_path / "missing" / "there.sqlite"), "check the address"),
    ):
        done = typed(*OWN, "--repository", address, cwd=tmp_path)
        assert done.returncode in (1, 2)
        assert words in done.stderr
        assert "starting a router" not in done.stderr


def test_a_password_is_kept_nowhere(tmp_path: Path, typed: Typed) -> None:
    address = "postgresql://me:se/secret@127.0.0.1:1/none"
    done = typed(*OWN, "--repository", address, cwd=tmp_path)
    assert done.returncode == 1
    assert "secret" not in done.stderr
    assert "check the address" in done.stderr
