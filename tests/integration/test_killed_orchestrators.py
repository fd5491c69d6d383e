"""An orchestrator that is killed at any instant loses no goal, repeats none, and ranks alike."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from fleet_lab import Lab
from orchestrator_lives import ROBOTS, Life, OrchestratorLives
from puppet_robot import PuppetRobot

from nufleet.orchestrator.repository.records import StudyStatus, TrialStatus
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.arrays import FloatArray

GAINS = {"target": 1.0, "near": 0.9, "far": 0.5}
TESTS = 2 * len(ROBOTS)
COMMITS = 3 + 2 * (1 + 2 * len(ROBOTS)) + 2
"""The most of an undisturbed study: leases, robots, study; each round's intents, acceptances and
responses; the study's end and the leases'. What several robots answer at once is one commit."""


def scaled(gain: float, references: FloatArray) -> FloatArray:
    return gain * references


@dataclass
class Scene:
    """Robots that stay, their repository, and orchestrators that come and go."""

    lives: OrchestratorLives
    endpoint: str
    robots: dict[str, PuppetRobot]
    repository: Repository
    path: Path
    orchestrators: int = 0

    def orchestrator(self, study_id: str, **more: object) -> bool:
        """Have one more orchestrator work on a study; return whether it was killed."""
        self.orchestrators += 1
        owner = f"orchestrator-{self.orchestrators}"
        life = Life(study_id, self.endpoint, str(self.path), owner, **more)  # type: ignore[arg-type]
        return self.lives.live(life)

    @property
    def motions(self) -> int:
        return sum(robot.motions for robot in self.robots.values())

    def check(self, study_id: str, undisturbed: object, motions: int, tests: int = TESTS) -> None:
        """Check what holds for every complete study, no matter what happened on the way."""
        study = self.repository.studies.study(study_id)
        trials = self.repository.studies.trials(study_id)
        assert study.status is StudyStatus.COMPLETE
        assert study.result == undisturbed
        assert all(trial.status.ended for trial in trials)
        measured = [trial for trial in trials if trial.status is TrialStatus.MEASURED]
        assert len(measured) == tests
        assert all(trial.interrupted for trial in trials if trial not in measured)
        # Each goal is one motion, however often it was sent; or none, where its orchestrator was
        # gone before its robot began.
        assert motions == sum(trial.robot_time_s > 0.0 for trial in trials)


@pytest.fixture
def scene(lab: Lab, tmp_path: Path) -> Iterator[Scene]:
    robots = {name: PuppetRobot() for name in ROBOTS}
    for name, robot in robots.items():
        robot.measure = partial(scaled, GAINS[name])
        lab.agent(name, robot)
    path = tmp_path / "nufleet.sqlite"
    with OrchestratorLives() as lives, open_repository(str(path)) as repository:
        yield Scene(lives, lab.endpoint, robots, repository, path)


def undisturbed(scene: Scene) -> object:
    assert not scene.orchestrator("undisturbed", killed_at=COMMITS + 1)
    result = scene.repository.studies.study("undisturbed").result
    scene.check("undisturbed", result, scene.motions)
    assert scene.motions == TESTS
    return result


def test_a_kill_at_any_commit_changes_nothing_of_what_a_study_comes_to(scene: Scene) -> None:
    expected = undisturbed(scene)
    for commit in range(1, COMMITS + 1):
        for before_commit in (True, False):
            study_id, before = f"killed-{commit}-{before_commit}".lower(), scene.motions
            killed = scene.orchestrator(study_id, killed_at=commit, before_commit=before_commit)
            assert killed or commit > COMMITS - 4 * (len(ROBOTS) - 1)
            assert not scene.orchestrator(study_id)
            scene.check(study_id, expected, scene.motions - before)


@pytest.mark.parametrize("algorithm", ["paper", "adaptive"])
def test_many_kills_in_one_study_change_nothing_of_what_it_comes_to(
    scene: Scene, algorithm: str
) -> None:
    assert not scene.orchestrator("undisturbed", algorithm=algorithm)
    expected = scene.repository.studies.study("undisturbed").result
    motions, kills, rng = scene.motions, 0, np.random.default_rng(1)
    while scene.orchestrator(
        "killed-often",
        algorithm=algorithm,
        killed_at=int(rng.integers(2, 6)),
        before_commit=bool(rng.integers(2)),
    ):
        kills += 1
    assert kills >= 5
    scene.check("killed-often", expected, scene.motions - motions, tests=motions)
