"""A study whose repository's disk is full: what cannot be stored does not move a robot."""

from __future__ import annotations

import shutil
import subprocess
from collections.abc import Iterator
from functools import partial
from pathlib import Path

import pytest
from fleet_lab import Lab
from orchestrator_lives import ROBOTS, Life, live
from polling import wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.conduct import leases as held_leases
from nufleet.orchestrator.repository.errors import RepositoryFullError
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.shared.arrays import FloatArray

ROOM = 160 * 1024
"""Enough for a round of the study, and not for two."""


def scaled(gain: float, references: FloatArray) -> FloatArray:
    return gain * references


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=4m", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True, check=False)
    assert done.returncode == 0, f"cannot mount a file system; run as root: {done.stderr}"
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


@pytest.fixture
def robots(lab: Lab) -> dict[str, PuppetRobot]:
    robots = {name: PuppetRobot() for name in ROBOTS}
    for (name, robot), gain in zip(robots.items(), (1.0, 0.9, 0.5), strict=True):
        robot.measure = partial(scaled, gain)
        lab.agent(name, robot)
    return robots


def test_a_full_disk_ends_a_study_with_its_robots_at_rest_and_it_goes_on_when_there_is_room(
    lab: Lab,
    robots: dict[str, PuppetRobot],
    small_disk: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(held_leases, "TERM_S", 3.0)
    monkeypatch.setattr(held_leases, "RENEW_EVERY_S", 0.3)
    live(Life("whole", lab.endpoint, str(tmp_path / "large.sqlite"), "orchestrator-1"))
    with open_repository(str(tmp_path / "large.sqlite")) as repository:
        undisturbed = repository.studies.study("whole").result
    before = {name: robot.motions for name, robot in robots.items()}
    database = str(small_disk / "nufleet.sqlite")
    with open_repository(database) as repository:
        ballast = small_disk / "ballast"
        ballast.write_bytes(bytes(shutil.disk_usage(small_disk).free - ROOM))
        with pytest.raises(RepositoryFullError, match="free some space and resume the run"):
            live(Life("small", lab.endpoint, database, "orchestrator-2"))
        wait_until(lambda: all(robot.at_rest for robot in robots.values()))
        trials = repository.studies.trials("small")
        assert len(trials) >= len(ROBOTS)
        for name, robot in robots.items():
            intents = [trial for trial in trials if trial.intent.robot == name]
            assert robot.motions - before[name] <= len(intents)
        ballast.unlink()
        live(Life("small", lab.endpoint, database, "orchestrator-3"))
        study, trials = repository.studies.study("small"), repository.studies.trials("small")
    assert study.status is StudyStatus.COMPLETE
    assert study.result == undisturbed
    # One motion for each goal; none for a goal whose owner was gone before its robot began.
    moved = [trial for trial in trials if trial.robot_time_s > 0.0]
    assert sum(r.motions for r in robots.values()) - sum(before.values()) == len(moved)
