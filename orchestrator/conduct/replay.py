"""Rebuilds a study from its stored trials and says what is open still. No network, no database.

A study is deterministic: made anew from its plan and seed and told the same answers, it asks the
same questions. So the trials are all that has to be kept, and what the study asks on the way is
compared with what was sent: a record of another algorithm or version is refused, not mixed in.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nufleet.orchestrator.repository.records import TrialRecord, TrialStatus
from nufleet.orchestrator.study.interface import Question, Report, Study
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import Excitation


class ResumeError(StudyError):
    """The stored trials are not those of this study."""


@dataclass(frozen=True)
class OpenTest:
    """A test without an answer: what is to be sent next, or was sent already.

    `record` is what is stored of exactly this attempt; None when it was never meant to be sent.
    `failures` counts the attempts before it that say something against the robot.
    """

    goal_id: str
    iteration: int
    robot: str
    attempt: int
    excitation: Excitation
    record: TrialRecord | None
    failures: int = 0

    @property
    def accepted_by(self) -> str | None:
        """The agent process that is known to have accepted it."""
        return None if self.record is None else self.record.boot_id

    def followed_by(self, study_id: str, excitation: Excitation, *, interrupted: bool) -> OpenTest:
        """Return the attempt after this one, which ended without an answer."""
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
    """A round that is complete: the trial that decided for each robot, and what was learned."""

    question: Question
    answers: Mapping[str, TrialRecord]
    report: Report


@dataclass(frozen=True)
class OpenRound:
    """A round in progress: the answers that there are, and the tests that have none."""

    question: Question
    answers: Mapping[str, TrialRecord]
    tests: tuple[OpenTest, ...]


@dataclass(frozen=True)
class Resumed:
    """Where a study stands; `open` is None when it is complete."""

    told: tuple[ToldRound, ...]
    open: OpenRound | None
    robot_time_s: float


def goal_id_of(study_id: str, iteration: int, robot: str, attempt: int) -> str:
    """Return the id of an attempt's goal: the same whoever sends it, and however often."""
    return f"{study_id}.{iteration}.{robot}.{attempt}"


def resume(study_id: str, study: Study, trials: Sequence[TrialRecord]) -> Resumed:
    """Bring a study that was just made to where its stored trials leave it.

    Args:
        study_id: the study's.
        study: made from the stored plan, seed and parameters, and not asked yet; afterwards it has
            been told every complete round, and asking it gives the open one.
        trials: all that are stored of it.

    Raises:
        ResumeError: the trials are not those that this study asks for.
        StudyError: it could not go on after one of its rounds, as it could not the first time.
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
            " did not ask for; resume it with the nufleet that began it"
        )
    robot_time_s = sum(trial.robot_time_s for trial in trials)
    return Resumed(tuple(told), open_round, robot_time_s)


_Attempts = dict[tuple[int, str], list[TrialRecord]]


def round_of(study_id: str, question: Question, stored: _Attempts | None = None) -> OpenRound:
    """Return a round as its stored attempts leave it, which are taken out of `stored`.

    Raises:
        ResumeError: the attempts do not follow from what is asked.
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
    """Tell a study the answers to its last question, as the trials that decided hold them."""
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
    """Return the trial that answers for a robot in a round, or the test that is to be done next.

    Args:
        study_id: the study's.
        iteration: the round's.
        robot: the robot's.
        excitation: what the study asks it to play.
        attempts: what is stored of them, in order.

    Raises:
        ResumeError: the attempts do not follow from what is asked.
    """
    failures = 0
    for number, trial in enumerate(attempts, start=1):
        expected_id = goal_id_of(study_id, iteration, robot, number)
        if (trial.intent.goal_id, trial.intent.excitation) != (expected_id, excitation):
            raise ResumeError(
                f"study {study_id} asks {robot} for goal {expected_id} with {_shown(excitation)}, "
                f"and goal {trial.intent.goal_id} with {_shown(trial.intent.excitation)} is stored;"
                " resume it with the nufleet that began it"
            )
        if trial.status is TrialStatus.MEASURED and trial.response is None:
            raise ResumeError(f"goal {expected_id} was measured, and its response is not stored")
        last = number == len(attempts)
        if trial.status.ended and (trial.status is TrialStatus.MEASURED or trial.retry is None):
            if last:
                return trial
            raise ResumeError(f"goal {expected_id} decided, and {robot} was tested again after it")
        if not trial.status.ended:
            if last:
                return OpenTest(expected_id, iteration, robot, number, excitation, trial, failures)
            raise ResumeError(f"goal {expected_id} has not ended, and another attempt is stored")
        excitation = trial.retry or excitation
        failures += not trial.interrupted
    number = len(attempts) + 1
    expected_id = goal_id_of(study_id, iteration, robot, number)
    return OpenTest(expected_id, iteration, robot, number, excitation, None, failures)


def _shown(excitation: Excitation) -> str:
    tones = [f"{tone.omega_rad_s:.17g}" for tone in excitation.tones]
    more = f" and {len(tones) - 3} more" if len(tones) > 3 else ""
    return f"{', '.join(tones[:3])}{more} rad/s on {excitation.axis}"
