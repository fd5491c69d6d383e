"""A study of a fleet from this process, and what it came to."""

from __future__ import annotations

import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import Conclusion, conduct
from nufleet.orchestrator.conduct.dispatcher import Dispatcher
from nufleet.orchestrator.conduct.leases import lease_robots
from nufleet.orchestrator.conduct.recipe import make_study, recipe_of
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.records import TrialRecord
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.study.interface import Question, Report, StudyPlan
from nufleet.orchestrator.study.outcomes import TestOutcome

BAND_RAD_S = (5.0, 40.0)


@dataclass
class Story:
    """What happened during a study: which attempts failed, robot, number and reason."""

    failed: list[tuple[str, int, str]] = field(default_factory=list)
    rounds: int = 0
    trials: tuple[TrialRecord, ...] = ()

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
    """Run a study from the beginning to its end; what is stored of it is gone afterwards."""
    descriptions = fleet.describe_all((plan.target, *plan.sources))
    with (
        tempfile.TemporaryDirectory(prefix="nufleet-faults-") as folder,
        open_repository(f"{folder}/nufleet.sqlite") as repository,
        lease_robots(repository.leases, fleet, "faults", descriptions) as leases,
    ):
        archive = Archive(repository, "faults", leases)
        begun = archive.begin(run_id, "paper", plan, seed, descriptions)
        log = archive.log(run_id)
        dispatcher = Dispatcher(
            fleet, log, recipe_of(begun).specs, on_attempt_failed=story.attempt_failed
        )
        conclusion = conduct(make_study(begun, repository.studies), log, dispatcher, story)
        story.trials = log.trials()
        return conclusion


def ranking_of(conclusion: Conclusion) -> list[tuple[str, float, int]]:
    """Return what two studies without noise must have in common, to the last bit."""
    return [(one.robot, one.psi, one.tests) for one in conclusion.report.ranking]
