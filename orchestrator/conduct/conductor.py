"""Conducts a study on a fleet: asks it, tests the robots, tells it, until it is done."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Protocol

from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.replay import ToldRound, resume, round_of
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.repository.records import TrialRecord, TrialStatus
from nufleet.orchestrator.study.interface import Question, Report, SourceEstimate, Study
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse


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
    study: Study, log: TrialLog, dispatcher: Dispatcher, observer: RankingObserver
) -> Conclusion:
    """Run a study from where its stored trials leave it to its end.

    Args:
        study: new, not asked yet.
        log: the study's trials; none are stored of a study that begins.
        dispatcher: tests the robots.
        observer: is told the rounds that are stored, too.

    Raises:
        StudyError: it cannot go on, since the target or every source is gone.
        ResumeError: the stored trials are not those of this study.
        RepositoryError: something could not be stored.
    """
    at = resume(log.study_id, study, log.trials())
    robot_time_s = at.robot_time_s
    report: Report | None = None
    for told in at.told:
        report = told.report
        _show(told, log, observer)
    now = at.open
    while now is not None:
        observer.asked(now.question)
        tested = dispatcher.run(now.tests)
        robot_time_s += sum(outcome.robot_time_s for outcome in tested.values())
        known = {robot: _outcome(trial, log) for robot, trial in now.answers.items()}
        # In the order of the question, whoever answered first.
        outcomes = {robot: {**known, **tested}[robot] for robot in now.question.tests}
        report = study.tell(
            {r: o.response for r, o in outcomes.items() if isinstance(o, Measured)},
            {r: o.reason for r, o in outcomes.items() if isinstance(o, Failed)},
        )
        observer.told(now.question, outcomes, report)
        question = study.ask()
        now = None if question is None else round_of(log.study_id, question)
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


def _show(told: ToldRound, log: TrialLog, observer: RankingObserver) -> None:
    observer.asked(told.question)
    outcomes = {robot: _outcome(trial, log) for robot, trial in told.answers.items()}
    observer.told(told.question, outcomes, told.report)


def _outcome(trial: TrialRecord, log: TrialLog) -> TestOutcome:
    """Return what came of a test that is stored."""
    intent = trial.intent
    if trial.status is TrialStatus.MEASURED and trial.response is not None:
        result = log.result(intent.goal_id)
        return Measured(intent.robot, trial.response, result, intent.attempt, trial.robot_time_s)
    return Failed(intent.robot, trial.reason, intent.attempt, trial.robot_time_s)
