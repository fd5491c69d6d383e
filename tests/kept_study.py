"""A repository in which a study of puppets has begun."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from puppet_robot import puppet_spec

from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.repository.records import RobotRecord, StudyRecord
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.orchestrator.study.interface import StudyPlan


@contextmanager
def kept_study(folder: Path, study_id: str, robots: tuple[str, ...]) -> Iterator[Repository]:
    with open_repository(f"{folder}/{study_id}.sqlite") as repository:
        for robot in robots:
            repository.robots.describe(RobotRecord("lab", robot, puppet_spec(), "boot"))
        plan = StudyPlan(robots[0], robots[1:], (0.1, 30.0), 1, "x")
        repository.studies.begin(StudyRecord(study_id, "lab", "paper", plan, 0))
        yield repository


@contextmanager
def trial_log(folder: Path, study_id: str, epochs: Mapping[str, int]) -> Iterator[TrialLog]:
    """Where the tests of some robots are kept, without leases."""
    with kept_study(folder, study_id, tuple(epochs)) as repository:
        yield TrialLog(repository.studies, study_id, epochs)
