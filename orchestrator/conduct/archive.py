"""One orchestrator's access to the repository for one fleet, under the leases that it holds."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from nufleet.orchestrator.conduct.leases import HeldLeases
from nufleet.orchestrator.conduct.recipe import AWAY, Recipe
from nufleet.orchestrator.conduct.replay import ResumeError, tried_again
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.repository.records import RobotRecord, StudyRecord, StudyStatus
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.errors import StudyError
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository


@dataclass(frozen=True)
class Archive:
    """Storage for the studies of one fleet."""

    repository: Repository
    """Repository in which the studies are stored."""
    fleet: str
    """Name under which the fleet's robots are leased and stored."""
    leases: HeldLeases
    """Leases under which this orchestrator commands the robots."""

    def log(self, study_id: str) -> TrialLog:
        """Return the log that stores the trials of a study that has begun."""
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
        """Store a study before any of its tests is sent.

        Args:
            study_id: Id of the study, the prefix of all its goal ids.
            algorithm: `paper` or `adaptive`.
            plan: Checked plan of the study.
            seed: Seed of the study's random generator.
            descriptions: Descriptions of the target and every source, by robot; that of a robot
                that is not there has the boot id `AWAY`.
            stored: Ids of earlier responses that replace tests, by robot.

        Returns:
            The record that was stored.

        Raises:
            RecordConflictError: A study of that id exists already.
            RepositoryError: The study cannot be stored.
        """
        parameters = Recipe.of(descriptions, stored or {}).parameters()
        record = StudyRecord(study_id, self.fleet, algorithm, plan, seed, parameters)
        self.repository.robots.describe(
            *(
                RobotRecord.of(self.fleet, description)
                for description in descriptions.values()
                if description.boot_id != AWAY
            )
        )
        self.repository.studies.begin(record)
        return record

    def try_again(self, study: StudyRecord) -> StudyRecord:
        """Store that a study which has failed continues where it did, once a person wants it.

        Returns:
            The study as it is then: still failed if no test of it was given up at its end.
        """
        studies = self.repository.studies
        trials = studies.trials(study.study_id)
        repeated = [
            trial.intent.goal_id
            for trial, again in zip(trials, tried_again(trials), strict=True)
            if again is not trial
        ]
        if not repeated:
            return study
        studies.reopen(study.study_id, repeated)
        return studies.study(study.study_id)

    @contextmanager
    def conducting(self, study_id: str, interrupt: Callable[[], None]) -> Iterator[None]:
        """Interrupt a study when a lease is lost, and store it as failed when it cannot continue.

        Any other error leaves the stored study open, so that it can be resumed.

        Args:
            study_id: Id of the study.
            interrupt: Function that makes the enclosed operation raise `Interrupted`.

        Raises:
            LeaseLostError: Another orchestrator has taken over a robot.
        """
        try:
            with self.leases.guarding(interrupt):
                yield
        except ResumeError:
            raise
        except StudyError as error:
            self.repository.studies.end(study_id, StudyStatus.FAILED, str(error))
            raise
