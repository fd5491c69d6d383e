"""Things that happen to a robot, to be written into its journal."""

from __future__ import annotations

from typing import Any

import numpy as np

from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.journal.ledger import Ledger
from nufleet.robot_agent.rules.goal_machine import Goal
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.frequency_test.excitation import ExcitationPlan, Tone
from nufleet.shared.wire.messages import GoalResult, Outcome

PLAN = ExcitationPlan(
    axis="x",
    tones=(Tone(omega_rad_s=0.1 + 0.2),),
    amplitude=0.1,
    sample_time_s=0.01,
    ramp_samples=2,
    settle_samples=1,
    segments=3,
    segment_samples=4,
)
DIGEST = "d" * 64


def goal(goal_id: str) -> Goal:
    return Goal(goal_id, "orchestrator-1", DIGEST)


def result(
    goal_id: str, *, outcome: Outcome = Outcome.COMPLETED, boot: str = "boot-1"
) -> GoalResult:
    samples = np.random.default_rng(len(goal_id)).standard_normal(PLAN.samples)
    return GoalResult(
        goal_id=goal_id,
        boot_id=boot,
        outcome=outcome,
        reason="",
        plan=PLAN,
        reference=samples,
        response=-samples,
    )


def write(journal: Journal, fact: tuple[Any, ...]) -> None:
    """Write one fact: its name and what it is about."""
    match fact:
        case ("accept", goal_id):
            journal.accepted(goal(goal_id), PLAN, "boot-1")
        case ("end", goal_id, outcome):
            journal.ended(result(goal_id, outcome=outcome))
        case ("forgo", goal_id):
            journal.forgone(goal_id)
        case ("acknowledge", *goal_ids):
            journal.acknowledged(goal_ids)
        case ("stop", sender):
            journal.stopped(StopOrder(sender, "look out"))
        case ("release", sender):
            journal.released(sender)
        case ("own", owner, epoch):
            journal.owned(owner, epoch)
        case _:
            raise ValueError(fact)


def content(ledger: Ledger) -> tuple[Any, ...]:
    """Everything that a ledger says, to be compared."""
    return dict(ledger.goals), ledger.kept, ledger.stop, ledger.owner
