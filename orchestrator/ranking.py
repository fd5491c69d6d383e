"""Conducts a study on a fleet: asks it, tests the robots, tells it, until it is done."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from orchestrator.dispatcher import Dispatcher, Failed, Measured, TestOutcome
from orchestrator.study import Question, Report, SourceEstimate, Study
from shared.excitation import Excitation, Tone

SEGMENTS = 4
SEGMENT_MIN_S = 2.0
"""A measuring segment is at least this long, so that fast tones are averaged over many periods."""


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
    """What a study came to: ranking best first, iterations done, robot-seconds, sources lost."""

    ranking: tuple[SourceEstimate, ...]
    iterations: int
    robot_time_s: float
    dropped: Mapping[str, str]

    @property
    def selected(self) -> str:
        """The source whose experience is expected to help most."""
        return self.ranking[0].robot


def conduct(
    study: Study, axis: str, run_id: str, dispatcher: Dispatcher, observer: RankingObserver
) -> Conclusion:
    """Run a study to its end.

    Raises:
        StudyError: it cannot go on, since the target or every source is gone.
    """
    robot_time_s = 0.0
    report: Report | None = None
    while (question := study.ask()) is not None:
        observer.asked(question)
        excitation = Excitation(
            axis=axis,
            tones=tuple(Tone(omega_rad_s=omega) for omega in question.omega_rad_s),
            segments=SEGMENTS,
            segment_min_s=SEGMENT_MIN_S,
        )
        outcomes = dispatcher.run(
            f"{run_id}.{question.iteration}", dict.fromkeys(question.robots, excitation)
        )
        robot_time_s += sum(outcome.robot_time_s for outcome in outcomes.values())
        report = study.tell(
            {r: o.response for r, o in outcomes.items() if isinstance(o, Measured)},
            {r: o.reason for r, o in outcomes.items() if isinstance(o, Failed)},
        )
        observer.told(question, outcomes, report)
    dispatcher.acknowledge_all()
    if report is None:
        raise ValueError("a study asks at least one question")
    return Conclusion(report.ranking, report.iteration, robot_time_s, report.dropped)
