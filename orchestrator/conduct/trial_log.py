"""Stores each test of a study before it is sent, when it is accepted and when it ends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from contextlib import AbstractContextManager
from typing import TYPE_CHECKING

from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.repository.records import TrialEnd, TrialIntent, TrialRecord
from nufleet.shared.wire.messages import GoalAccepted, GoalResult

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.study_store import StudyStore


class TrialLog:
    """The trials of one study in a repository.

    Many threads may use it at once, and every method may raise RepositoryError.
    """

    def __init__(self, studies: StudyStore, study_id: str, epochs: Mapping[str, int]) -> None:
        """Prepare to store.

        Args:
            studies: Store in which the study has already begun.
            study_id: Id of the study.
            epochs: Epoch of the lease under which this process commands each robot, by robot.
        """
        self._studies = studies
        self.study_id = study_id
        self.epochs = epochs

    def trials(self) -> tuple[TrialRecord, ...]:
        """Return all stored trials of the study."""
        return self._studies.trials(self.study_id)

    def result(self, goal_id: str) -> GoalResult:
        """Return the result, with its samples, that a robot returned for an ended test."""
        return self._studies.result(goal_id)

    def intend(self, tests: Iterable[OpenTest]) -> None:
        """Store that tests are about to be sent."""
        self._studies.intend(
            *(
                TrialIntent(
                    goal_id=test.goal_id,
                    study_id=self.study_id,
                    iteration=test.iteration,
                    robot=test.robot,
                    attempt=test.attempt,
                    excitation=test.excitation,
                    epoch=self.epochs[test.robot],
                )
                for test in tests
            )
        )

    def accepted(self, test: OpenTest, accepted: GoalAccepted) -> None:
        """Store that the robot has accepted a test."""
        self._studies.accepted(accepted, epoch=self.epochs[test.robot])

    def ending(self) -> AbstractContextManager[None]:
        """Return a context in which to prepare the end of a test, so that ends share a commit."""
        return self._studies.ending()

    def ended(self, test: OpenTest, end: TrialEnd) -> None:
        """Store how a test ended, with the data that it gave."""
        self._studies.ended(test.goal_id, end, epoch=self.epochs[test.robot])
