"""Conducts a study on a fleet: asks it, tests the robots, tells it, until it is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from orchestrator.dispatcher import Dispatcher, Failed, Measured, TestOutcome
from orchestrator.study import Question, Report, SourceEstimate, Study
from shared.frequency_response import FrequencyResponse


class RankingObserver(Protocol):
    """Is told what happens; `asked` and `told` come from the thread that conducts the study."""

    def asked(self, question: Question) -> None:
        """A round of tests begins."""

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """A test gave nothing usable and is repeated or given up; comes from other threads."""

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """A round ended, and this is what it taught."""


@dataclass(frozen=True)
class Conclusion:
    """What a study came to: ranking best first, iterations done, robot-seconds, sources lost.

    `responses` are all that are known of each robot, from before the study too.
    """

    ranking: tuple[SourceEstimate, ...]
    iterations: int
    robot_time_s: float
    dropped: Mapping[str, str]
    responses: Mapping[str, Sequence[FrequencyResponse]] = field(default_factory=dict)
    confidence: float | None = None
    eliminated: Mapping[str, str] = field(default_factory=dict)
    findings: tuple[str, ...] = ()
    stopped_because: str | None = None

    @property
    def selected(self) -> str:
        """The source whose experience is expected to help most."""
        return self.ranking[0].robot


def conduct(
    study: Study, run_id: str, dispatcher: Dispatcher, observer: RankingObserver
) -> Conclusion:
    """Run a study to its end.

    Raises:
        StudyError: it cannot go on, since the target or every source is gone.
    """
    robot_time_s = 0.0
    report: Report | None = None
    while (question := study.ask()) is not None:
        observer.asked(question)
        outcomes = dispatcher.run(f"{run_id}.{question.iteration}", question.tests)
        robot_time_s += sum(outcome.robot_time_s for outcome in outcomes.values())
        report = study.tell(
            {r: o.response for r, o in outcomes.items() if isinstance(o, Measured)},
            {r: o.reason for r, o in outcomes.items() if isinstance(o, Failed)},
        )
        observer.told(question, outcomes, report)
    dispatcher.acknowledge_all()
    if report is None:
        raise ValueError("a study asks at least one question")
    return Conclusion(
        ranking=report.ranking,
        iterations=report.iteration,
        robot_time_s=robot_time_s,
        dropped=report.dropped,
        responses=study.responses,
        confidence=report.confidence,
        eliminated=report.eliminated,
        findings=report.findings,
        stopped_because=report.stopped_because,
    )
