"""What robots would do in an evaluation, before any of them moves."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import pairwise

from nufleet.orchestrator.conduct.first_round import planned_test
from nufleet.orchestrator.evaluation.run import EvaluationPlan, has_experience
from nufleet.orchestrator.experience.learning import planned_lessons
from nufleet.orchestrator.flights.planned import (
    Outlook,
    PlannedMotion,
    path_motion,
    rich_motion,
)
from nufleet.orchestrator.study.paper_algorithm import slowest_test
from nufleet.shared.wire.messages import Description


def planned_evaluation(plans: Sequence[EvaluationPlan], *, resumed: bool = False) -> Outlook:
    """Return what the robots of an evaluation would do.

    Args:
        plans: Checked plan of every target.
        resumed: Whether a part of it was done before, which is not repeated.
    """
    learners: dict[str, Description] = {}
    for plan in plans:
        for source in plan.ready.plan.sources:
            learner = plan.ready.descriptions[source]
            if not has_experience(learner, plan.architecture):
                learners.setdefault(source, learner)
    targets = ", ".join(plan.ready.plan.target for plan in plans)
    later = ["the rounds of the adaptive ranking depend on what they show"]
    if any(plan.ready.plan.also for plan in plans):
        later.append(
            "where axes differ in their closest source, each path is flown once more, with that of "
            "each axis"
        )
    if resumed:
        later.append("what was done before the interruption is not done again")
    return Outlook(
        headline=f"evaluation of {targets}",
        later="; ".join(later),
        motions=(
            *(motion for one in learners.values() for motion in _lessons(plans[0], one)),
            *(motion for plan in plans for motion in _tests(plan)),
            *(motion for plan in plans for motion in _flights(plan)),
        ),
    )


def _lessons(plan: EvaluationPlan, learner: Description) -> tuple[PlannedMotion, ...]:
    return planned_lessons(learner, (plan.architecture,), seed=plan.seed, duration_s=plan.flight_s)


def _tests(plan: EvaluationPlan) -> Iterator[PlannedMotion]:
    study = plan.ready.plan
    times = len(plan.seeds) * study.iterations
    for robot in (study.target, *study.sources):
        spec = plan.ready.descriptions[robot].spec
        yield planned_test(robot, slowest_test(study), spec, times=times, what="single tones")


def _flights(plan: EvaluationPlan) -> Iterator[PlannedMotion]:
    """Yield the target's flights; see `fly_target`."""
    target = plan.ready.descriptions[plan.ready.plan.target]
    points = len(plan.own_flight_s)
    # With every source, their mixture, a zero prior and its baseline; at every point with its own.
    times = len(plan.ready.plan.sources) + 3 + points
    for leg in plan.legs:
        yield path_motion(target, leg, corrected=True, times=times)
    for before_s, after_s in pairwise(plan.own_flight_s):
        yield rich_motion(target, duration_s=after_s - before_s, seed=plan.seed)
