"""Conducts a study on a fleet: asks, tests the robots and passes on the answers, until it ends."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.replay import ToldRound, resume, round_of
from nufleet.orchestrator.conduct.trial_log import TrialLog
from nufleet.orchestrator.repository.records import TrialRecord, TrialStatus
from nufleet.orchestrator.study.interface import Question, Report, Study
from nufleet.orchestrator.study.outcomes import Failed, Measured, TestOutcome
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse


class RankingObserver(Protocol):
    """Receives the events of a study.

    `asked` and `told` are called on the thread that conducts the study.
    """

    def asked(self, question: Question) -> None:
        """Handle the beginning of a round of tests."""

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Handle an attempt without a usable response; called on other threads.

        Args:
            robot: Name of the robot under test.
            attempt: Number of the attempt in the round, from 1.
            reason: Reason why there is no usable response.
        """

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Handle the end of a round.

        Args:
            question: Tests of the round.
            outcomes: Outcome of each test, by robot.
            report: Report of the study after these outcomes.
        """


@dataclass(frozen=True)
class Conclusion:
    """The final result of a study."""

    report: Report
    """Report of the study after its last round."""
    robot_time_s: float
    """Time that all robots together have moved for the study, in s."""
    responses: Mapping[str, Sequence[FrequencyResponse]]
    """All known responses of each robot, including those from before the study."""


def conduct(
    study: Study, log: TrialLog, dispatcher: Dispatcher, observer: RankingObserver
) -> Conclusion:
    """Replay a study's stored trials, then run it to its end.

    Args:
        study: Newly built study that has not been asked yet.
        log: Trials of the study; empty for a study that begins.
        dispatcher: Dispatcher that runs the tests on the robots.
        observer: Object that is notified of every round, replayed rounds included.

    Returns:
        The final result of the study.

    Raises:
        StudyError: The study cannot continue, because the target or every source is gone.
        ResumeError: The stored trials do not belong to this study.
        RepositoryError: Something could not be stored.
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
        # In the order of the question, not of arrival, so that a replay gives the same study.
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
    return Conclusion(report, robot_time_s, study.responses)


def _show(told: ToldRound, log: TrialLog, observer: RankingObserver) -> None:
    observer.asked(told.question)
    outcomes = {robot: _outcome(trial, log) for robot, trial in told.answers.items()}
    observer.told(told.question, outcomes, told.report)


def _outcome(trial: TrialRecord, log: TrialLog) -> TestOutcome:
    """Return the outcome of a stored test."""
    intent = trial.intent
    if trial.status is TrialStatus.MEASURED and trial.response is not None:
        result = log.result(intent.goal_id)
        return Measured(intent.robot, trial.response, result, intent.attempt, trial.robot_time_s)
    return Failed(intent.robot, trial.reason, intent.attempt, trial.robot_time_s)
