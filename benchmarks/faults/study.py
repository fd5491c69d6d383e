"""A study of a fleet from this process, and what it came to."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from orchestrator.dispatcher import Dispatcher, TestOutcome
from orchestrator.experience_selection import PaperStudy
from orchestrator.fleet import Fleet
from orchestrator.ranking import Conclusion, conduct
from orchestrator.study import Question, Report, StudyPlan

BAND_RAD_S = (5.0, 40.0)


@dataclass
class Story:
    """What happened during a study: which attempts failed, robot, number and reason."""

    failed: list[tuple[str, int, str]] = field(default_factory=list)
    rounds: int = 0

    def asked(self, question: Question) -> None:
        """A round begins."""
        self.rounds = question.iteration

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Note it."""
        self.failed.append((robot, attempt, reason))

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Nothing to note."""


def plan_of(
    robots: tuple[str, ...], *, iterations: int, band_rad_s: tuple[float, float] = BAND_RAD_S
) -> StudyPlan:
    """Return the plan to find out which robot is closest to the first one."""
    return StudyPlan(
        target=robots[0], sources=robots[1:], band_rad_s=band_rad_s, iterations=iterations, axis="x"
    )


def run_study(
    fleet: Fleet, plan: StudyPlan, run_id: str, story: Story, seed: int = 1
) -> Conclusion:
    """Run a study from the beginning to its end."""
    dispatcher = Dispatcher(fleet, on_attempt_failed=story.attempt_failed)
    return conduct(PaperStudy(plan, np.random.default_rng(seed)), run_id, dispatcher, story)


def ranking_of(conclusion: Conclusion) -> list[tuple[str, float, int]]:
    """Return what two studies without noise must have in common, to the last bit."""
    return [(one.robot, one.psi, one.tests) for one in conclusion.ranking]
