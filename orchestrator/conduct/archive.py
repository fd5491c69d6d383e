"""The repository as one orchestrator uses it for one fleet, under the leases that it holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nufleet.orchestrator.conduct.leases import HeldLeases
from nufleet.orchestrator.conduct.recipe import Recipe
from nufleet.orchestrator.conduct.replay import ResumeError
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.repository.records import RobotRecord, StudyRecord, StudyStatus
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.errors import StudyError
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository


@dataclass(frozen=True)
class Archive:
    """Where studies of a fleet are kept; `leases` are those of its robots."""

    repository: Repository
    fleet: str
    leases: HeldLeases

    def log(self, study_id: str) -> TrialLog:
        """Return what stores the trials of a study that has begun."""
        return TrialLog(self.repository.studies, study_id, self.leases.epochs)

    def begin(
        self,
        study_id: str,
        algorithm: str,
        plan: StudyPlan,
        seed: int,
        descriptions: Mapping[str, Description],
        stored: Mapping[str, tuple[str, ...]] | None = None,
    ) -> StudyRecord:
        """Store a study before anything of it is sent.

        Args:
            study_id: the prefix of its goal ids.
            algorithm: `paper` or `adaptive`.
            plan: what is to be found out.
            seed: of its generator.
            descriptions: of the target and every source.
            stored: the goals of earlier studies whose responses it begins with, by robot.

        Raises:
            RecordConflictError: there is a study of that id.
            RepositoryError: it cannot be stored.
        """
        specs = {robot: description.spec for robot, description in descriptions.items()}
        recipe = Recipe(specs=specs, stored=dict(stored or {}))
        record = StudyRecord(study_id, self.fleet, algorithm, plan, seed, recipe.parameters())
        self.repository.robots.describe(
            *(
                RobotRecord(self.fleet, robot, description.spec, description.boot_id)
                for robot, description in descriptions.items()
                if robot not in recipe.stored
            )
        )
        self.repository.studies.begin(record)
        return record

    @contextmanager
    def conducting(self, study_id: str, interrupt: Callable[[], None]) -> Iterator[None]:
        """Have a study interrupted when a lease is lost, and stored as failed when it cannot go on.

        Whatever else ends it leaves it open, so that it can be resumed.
        """
        try:
            with self.leases.guarding(interrupt):
                yield
        except ResumeError:
            raise
        except StudyError as error:
            self.repository.studies.end(study_id, StudyStatus.FAILED, str(error))
            raise
