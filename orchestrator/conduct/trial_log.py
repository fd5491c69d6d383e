"""What a study stores of its tests: before each is sent, when it is taken and when it ends."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING

from nufleet.orchestrator.conduct.replay import OpenTest
from nufleet.orchestrator.repository.records import TrialIntent, TrialRecord
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import GoalAccepted, GoalResult

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.study_store import StudyStore


class TrialLog:
    """One study's part of a repository; usable from many threads. Raises RepositoryError."""

    def __init__(self, studies: StudyStore, study_id: str, epochs: Mapping[str, int]) -> None:
        """Prepare to store.

        Args:
            studies: where; the study has begun there.
            study_id: which.
            epochs: per robot, the epoch of the lease under which this process commands it.
        """
        self._studies = studies
        self.study_id = study_id
        self.epochs = epochs

    def trials(self) -> tuple[TrialRecord, ...]:
        """Return all that is stored."""
        return self._studies.trials(self.study_id)

    def result(self, goal_id: str) -> GoalResult:
        """Return what a robot returned of a test that ended."""
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
        """Store that its robot has taken a test."""
        self._studies.accepted(accepted, epoch=self.epochs[test.robot])

    def measured(self, test: OpenTest, result: GoalResult, response: FrequencyResponse) -> None:
        """Store a usable response and the samples that it came from."""
        self._studies.measured(result, response, epoch=self.epochs[test.robot])

    def failed(
        self,
        test: OpenTest,
        reason: str,
        *,
        retry: Excitation | None,
        interrupted: bool = False,
        result: GoalResult | None = None,
        response: FrequencyResponse | None = None,
    ) -> None:
        """Store that a test gave nothing usable, and what its robot plays next."""
        self._studies.failed(
            test.goal_id,
            reason,
            retry=retry,
            epoch=self.epochs[test.robot],
            result=result,
            response=response,
            interrupted=interrupted,
        )

    def lost(
        self, test: OpenTest, reason: str, *, retry: Excitation | None, interrupted: bool
    ) -> None:
        """Store that nobody will know what came of a test."""
        self._studies.lost(
            test.goal_id,
            reason,
            retry=retry,
            epoch=self.epochs[test.robot],
            interrupted=interrupted,
        )
