"""Runs that are interrupted and go on, as a user and as another program see them."""

from __future__ import annotations

import json
import signal
import sqlite3
import subprocess
from collections.abc import Iterator
from contextlib import closing, contextmanager
from pathlib import Path

import psutil
import pytest
from polling import wait_until
from test_rank_command import FLEET, NUFLEET, nufleet

from orchestrator.repository.records import StudyStatus, TrialStatus
from orchestrator.repository.repository import open_repository

RANK = (
    *("rank", "--fleet", str(FLEET), "--algorithm", "paper"),
    *("--band", "2", "10", "--iterations", "3", "--seed", "5"),
)


@contextmanager
def ranking(cwd: Path, *arguments: str) -> Iterator[subprocess.Popen[str]]:
    """A ranking that runs; whatever is left of it afterwards is killed."""
    with subprocess.Popen(
        [*NUFLEET, *arguments],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    ) as process:
        try:
            yield process
        finally:
            process.kill()


def trials(database: Path) -> list[str]:
    """How far each trial is; read beside the process that writes them, without a lock."""
    if not database.exists():
        return []
    with closing(sqlite3.connect(f"file:{database}?mode=ro", uri=True)) as connection:
        try:
            return [status for (status,) in connection.execute("SELECT status FROM trials")]
        except sqlite3.OperationalError:  # its tables are not made yet
            return []


def under_way(database: Path) -> bool:
    """Whether some tests have been measured and others are in progress."""
    found = trials(database)
    return "measured" in found and "accepted" in found[4:]


def resume(cwd: Path, run: str = "latest", *arguments: str) -> subprocess.CompletedProcess[str]:
    return nufleet("rank", "--resume", run, *arguments, cwd=cwd)


def test_a_killed_ranking_of_a_fleet_of_its_own_goes_on_with_one_that_is_started_again(
    tmp_path: Path,
) -> None:
    undisturbed = json.loads(nufleet(*RANK, "--runs", "undisturbed", "--json", cwd=tmp_path).stdout)
    with ranking(tmp_path, *RANK, "--realtime", "10") as killed:
        wait_until(lambda: under_way(tmp_path / "runs" / "nufleet.sqlite"))
        children = psutil.Process(killed.pid).children(recursive=True)
        killed.kill()
        killed.communicate()
        psutil.wait_procs(children, timeout=20)
    (run,) = [path for path in (tmp_path / "runs").iterdir() if path.is_dir()]
    assert not (run / "results.json").exists()
    done = resume(tmp_path, "latest", "--json")
    assert done.returncode == 0, done.stderr
    document = json.loads(done.stdout)
    assert Path(document["run"]).name == run.name
    # The robots' own states differ by less than their tolerance at rest.
    for row, expected in zip(document["ranking"], undisturbed["ranking"], strict=True):
        assert row["robot"] == expected["robot"]
        assert row["psi"] == pytest.approx(expected["psi"], abs=1e-5)
        assert row["tests"] == expected["tests"]
    assert {path.name for path in run.iterdir()} == {
        *("config.json", "results.json", "telemetry.parquet", "run.rrd", "plots", "report.md")
    }
    with open_repository(str(tmp_path / "runs" / "nufleet.sqlite")) as repository:
        study = repository.studies.study(run.name.lower())
        kept = repository.studies.trials(study.study_id)
    assert study.status is StudyStatus.COMPLETE
    assert study.result == document
    assert len([t for t in kept if t.status is TrialStatus.MEASURED]) == 3 * 4
    assert all(t.interrupted for t in kept if t.status is not TrialStatus.MEASURED)
    again = resume(tmp_path, run.name)
    assert again.returncode == 2
    assert "is complete" in again.stderr


def test_ctrl_c_says_how_to_go_on_and_rank_does_it_too(tmp_path: Path) -> None:
    with ranking(tmp_path, *RANK, "--realtime", "10", "--runs", "here") as interrupted:
        wait_until(lambda: under_way(tmp_path / "here" / "nufleet.sqlite"))
        interrupted.send_signal(signal.SIGINT)
        _, said = interrupted.communicate(timeout=60)
    assert interrupted.returncode == 130
    (run,) = [path for path in (tmp_path / "here").iterdir() if path.is_dir()]
    assert f"runs resume {run.name} --runs here" in said
    # Nobody has to wait: it gave its robots back.
    with open_repository(str(tmp_path / "here" / "nufleet.sqlite")) as repository:
        assert not repository.leases.held(f"paper-linear/{run.name.lower()}")
    clash = nufleet("rank", "--resume", run.name, "--runs", "here", "--seed", "1", cwd=tmp_path)
    assert clash.returncode == 2
    assert "--seed is that of the run" in clash.stderr
    done = nufleet("rank", "--resume", run.name, "--runs", "here", "--json", cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    assert json.loads(done.stdout)["selected"] == "source-2"


def test_nothing_to_resume_is_an_error_that_says_what_there_is(tmp_path: Path) -> None:
    (tmp_path / "runs").mkdir()
    for command in (["runs", "resume"], ["rank", "--resume", "latest"]):
        done = nufleet(*command, cwd=tmp_path)
        assert done.returncode == 2
        assert "no run in runs was interrupted" in done.stderr


def test_a_repository_that_cannot_be_used_is_refused_before_anything_starts(
    tmp_path: Path,
) -> None:
    for address, words in (
        ("mysql://host/db", "expected a file"),
        (str(tmp_path / "missing" / "there.sqlite"), "check the address"),
    ):
        done = nufleet(*RANK, "--repository", address, cwd=tmp_path)
        assert done.returncode in (1, 2)
        assert words in done.stderr
        assert "starting a router" not in done.stderr


def test_a_password_is_kept_nowhere(tmp_path: Path) -> None:
    address = "postgresql://me:secret@127.0.0.1:1/none"
    done = nufleet(*RANK, "--repository", address, cwd=tmp_path)
    assert done.returncode == 1
    assert "secret" not in done.stderr
    assert "check the address" in done.stderr
