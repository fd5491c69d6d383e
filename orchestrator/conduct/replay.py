"""Rebuilds a study from its stored trials and finds its open tests. No network, no database.

A study is deterministic: rebuilt from the same plan and seed and given the same answers, it asks
the same questions. Its trials are therefore all that has to be stored. During the replay every
question is compared with the test that was sent, so that a record of another algorithm or version
is refused rather than mixed in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

from nufleet.orchestrator.repository.records import TrialRecord, TrialStatus
from nufleet.orchestrator.study.interface import Question, Report, Study
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import Excitation


class ResumeError(StudyError):
    """The stored trials do not belong to this study."""


@dataclass(frozen=True)
class OpenTest:
    """An attempt at a test that has no answer yet: to be sent next, or sent already."""

    goal_id: str
    """Id of the attempt's goal; see `goal_id_of`."""
    iteration: int
    """Number of the round, from 1."""
    robot: str
    """Name of the robot under test."""
    attempt: int
    """Number of this attempt in the round, from 1."""
    excitation: Excitation
    """Motion that the robot is to play."""
    record: TrialRecord | None
    """Stored trial of this very attempt; None when no intent to send it was ever stored."""
    failures: int = 0
    """Number of earlier attempts in the round that count as failures of the robot."""

    @property
    def accepted_by(self) -> str | None:
        """Boot id of the agent process known to have accepted it; None when none is known."""
        return None if self.record is None else self.record.boot_id

    def followed_by(self, study_id: str, excitation: Excitation, *, interrupted: bool) -> OpenTest:
        """Return the attempt that follows this one.

        Args:
            study_id: Prefix of all goal ids of this study.
            excitation: Motion that the robot is to play in the next attempt.
            interrupted: Whether this attempt ended through no fault of the robot, and hence does
                not count as a failure.
        """
        number = self.attempt + 1
        return OpenTest(
            goal_id_of(study_id, self.iteration, self.robot, number),
            self.iteration,
            self.robot,
            number,
            excitation,
            None,
            self.failures + (not interrupted),
        )


@dataclass(frozen=True)
class ToldRound:
    """A complete round, as it was replayed."""

    question: Question
    """Tests that the study asked for."""
    answers: Mapping[str, TrialRecord]
    """Trial that decided each robot's test, by robot."""
    report: Report
    """Report that the study returned for these answers."""


@dataclass(frozen=True)
class OpenRound:
    """A round in progress."""

    question: Question
    """Tests that the study asked for."""
    answers: Mapping[str, TrialRecord]
    """Trials that are decided, by robot."""
    tests: tuple[OpenTest, ...]
    """Attempts that are still open, one for each robot without an answer."""


@dataclass(frozen=True)
class Resumed:
    """The state of a study after its replay."""

    told: tuple[ToldRound, ...]
    """Complete rounds, in order."""
    open: OpenRound | None
    """Round in progress; None when the study is complete."""
    robot_time_s: float
    """Time that all robots together have moved for the study, in s."""


def goal_id_of(study_id: str, iteration: int, robot: str, attempt: int) -> str:
    """Return the id of an attempt's goal, which is the same for every sender and every sending."""
    return f"{study_id}.{iteration}.{robot}.{attempt}"


def resume(study_id: str, study: Study, trials: Sequence[TrialRecord]) -> Resumed:
    """Replay stored trials to a newly built study, up to its first open round.

    Args:
        study_id: Prefix of all goal ids of this study.
        study: Study built from the stored plan, seed and parameters, and not asked yet. On return
            it has received the answers of every complete round, and its last question is the open
            round.
        trials: All stored trials of this study, in any order.

    Returns:
        The replayed rounds and the round in progress.

    Raises:
        ResumeError: The trials do not match the study's questions.
        StudyError: The study cannot continue after one of its rounds, as it could not the first
            time.
    """
    left: _Attempts = {}
    for trial in sorted(trials, key=lambda t: t.intent.attempt):
        left.setdefault((trial.intent.iteration, trial.intent.robot), []).append(trial)
    told: list[ToldRound] = []
    open_round: OpenRound | None = None
    while open_round is None and (question := study.ask()) is not None:
        found = round_of(study_id, question, left)
        if found.tests:
            open_round = found
        else:
            told.append(ToldRound(question, found.answers, tell(study, found.answers)))
    if left:
        iteration, robot = min(left)
        raise ResumeError(
            f"study {study_id}: a test of {robot} in iteration {iteration} is stored that the study"
            " did not request; resume it with the version of nufleet that began it"
        )
    robot_time_s = sum(trial.robot_time_s for trial in trials)
    return Resumed(tuple(told), open_round, robot_time_s)


_Attempts = dict[tuple[int, str], list[TrialRecord]]


def tried_again(trials: Sequence[TrialRecord]) -> tuple[TrialRecord, ...]:
    """Return the trials as if those that were given up in the last round were to be repeated.

    Args:
        trials: All stored trials of a study.
    """
    last = max((trial.intent.iteration for trial in trials), default=0)

    def again(trial: TrialRecord) -> TrialRecord:
        if trial.intent.iteration != last or not trial.given_up:
            return trial
        return replace(trial, retry=trial.intent.excitation, interrupted=True)

    return tuple(map(again, trials))


def round_of(study_id: str, question: Question, stored: _Attempts | None = None) -> OpenRound:
    """Return the state of a round after its stored attempts.

    Args:
        study_id: Prefix of all goal ids of this study.
        question: Tests that the study asks for in this round.
        stored: Stored attempts by iteration and robot, in order; those of this round are removed.

    Raises:
        ResumeError: The attempts do not match the question.
    """
    answers: dict[str, TrialRecord] = {}
    tests: list[OpenTest] = []
    for robot, excitation in question.tests.items():
        attempts = (stored or {}).pop((question.iteration, robot), [])
        found = next_of(study_id, question.iteration, robot, excitation, attempts)
        if isinstance(found, OpenTest):
            tests.append(found)
        else:
            answers[robot] = found
    return OpenRound(question, answers, tuple(tests))


def tell(study: Study, answers: Mapping[str, TrialRecord]) -> Report:
    """Give a study the answers to its last question and return its report.

    Args:
        study: Study that waits for answers.
        answers: Trial that decided each robot's test, by robot.

    Raises:
        StudyError: The study cannot continue, because the target or every source is gone.
    """
    return study.tell(
        {
            robot: trial.response
            for robot, trial in answers.items()
            if trial.status is TrialStatus.MEASURED and trial.response is not None
        },
        {
            robot: trial.reason
            for robot, trial in answers.items()
            if trial.status is not TrialStatus.MEASURED
        },
    )


def next_of(
    study_id: str,
    iteration: int,
    robot: str,
    excitation: Excitation,
    attempts: Sequence[TrialRecord],
) -> TrialRecord | OpenTest:
    """Return the trial that decided a robot's test in a round, or its open attempt.

    Args:
        study_id: Prefix of all goal ids of this study.
        iteration: Round number, from 1.
        robot: Name of the robot under test.
        excitation: Test requested in this round.
        attempts: Stored attempts at this test, in order.

    Raises:
        ResumeError: The attempts do not match the requested test.
    """
    failures = 0
    for number, trial in enumerate(attempts, start=1):
        expected_id = goal_id_of(study_id, iteration, robot, number)
        if (trial.intent.goal_id, trial.intent.excitation) != (expected_id, excitation):
            raise ResumeError(
                f"study {study_id} requests goal {expected_id} with {_shown(excitation)} from "
                f"{robot}, but goal {trial.intent.goal_id} with {_shown(trial.intent.excitation)} "
                "is stored; resume it with the version of nufleet that began it"
            )
        if trial.status is TrialStatus.MEASURED and trial.response is None:
            raise ResumeError(f"goal {expected_id} was measured, but its response is not stored")
        last = number == len(attempts)
        if trial.status.ended and (trial.status is TrialStatus.MEASURED or trial.retry is None):
            if last:
                return trial
            raise ResumeError(
                f"goal {expected_id} was final, but {robot} was tested again after it"
            )
        if not trial.status.ended:
            if last:
                return OpenTest(expected_id, iteration, robot, number, excitation, trial, failures)
            raise ResumeError(f"goal {expected_id} has not ended, but another attempt is stored")
        excitation = trial.retry or excitation
        failures += not trial.interrupted
    number = len(attempts) + 1
    expected_id = goal_id_of(study_id, iteration, robot, number)
    return OpenTest(expected_id, iteration, robot, number, excitation, None, failures)


def _shown(excitation: Excitation) -> str:
    tones = [f"{tone.omega_rad_s:.17g}" for tone in excitation.tones]
    more = f" and {len(tones) - 3} more" if len(tones) > 3 else ""
    return f"{', '.join(tones[:3])}{more} rad/s on {excitation.axis}"
