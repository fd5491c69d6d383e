"""Asks the target of a command what it expects of a path, and says so; failing that, says why."""

from __future__ import annotations

from nufleet.orchestrator.conduct.desired_motion import TimedPath, leg_of
from nufleet.orchestrator.conduct.rank_run import ReadyStudy
from nufleet.orchestrator.experience.foresight import expected, foresee
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.flights.legs import Leg, typical_leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.flights.ways import Foresight, error_range
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.terminal import rehearsal_shown
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.shared.errors import (
    InvalidInputError,
    MalformedMessageError,
    NoReplyError,
    RefusedError,
    RobotLostError,
)
from nufleet.shared.wire.messages import Description, ForeseenWay

_UNANSWERED = (
    InvalidInputError,
    MalformedMessageError,
    NoReplyError,
    RefusedError,
    RobotLostError,
)


def foreseen(
    run: Opening, ready: ReadyStudy, result: RankResult, drawing: TimedPath | None
) -> tuple[Foresight, Leg] | None:
    """Return what the target of a ranking expects of all ways to fly; None if it cannot tell.

    A ranking is of use without it, so that its failure is printed and does no harm.

    Args:
        run: Everything that is open; the target and the sources are leased.
        ready: Study, prepared and checked.
        result: Result of the ranking.
        drawing: Drawing to be flown; None for a typical one.

    Returns:
        What it expects, and the path that it was asked about.
    """
    fleet, name, _ = run.connection
    robot = ready.plan.target
    try:
        target = fleet.describe(robot)
        if target.spec.tracking is None:
            return None
        leg = typical_leg(target) if drawing is None else leg_of(drawing, target)
        run.console.print(f"{robot} rehearses {leg.title} in every way it could fly it")
        store = run.repository.robots if run.choice.file is None else None
        psi = {one.robot: one.psi for one in result.ranking}
        pilot = Pilot(fleet, run.folder.study_id)
        library = ExperienceLibrary(fleet, store, name, ready.descriptions)
        with rehearsal_shown(run.console) as shown:
            return foresee(fleet, pilot, library, target, tuple(psi), leg, psi, shown), leg
    except _UNANSWERED as error:
        run.console.print(f"[yellow]which way to fly could not be predicted: {error}[/]")
        return None


def say_expected(run: Opening, target: Description, way: ForeseenWay, leg: Leg, name: str) -> None:
    """Print what a target expects of one way to fly a path, beside its baseline.

    Args:
        run: Everything that is open.
        target: Description of the robot.
        way: The way; the robot holds the priors that it needs.
        leg: Path.
        name: Name of the way; see `nufleet.orchestrator.flights.labels`.
    """
    try:
        with rehearsal_shown(run.console) as shown:
            foresight = expected(run.connection.fleet, target, way, leg, name, shown)
    except _UNANSWERED as error:
        run.console.print(f"[yellow]{leg.title}: no error could be predicted: {error}[/]")
        return
    if foresight.unseen is not None:
        run.console.print(f"[yellow]{leg.title}: {foresight.unseen}[/]")
    record = foresight.ways[-1]
    if record.predicted is None:
        run.console.print(f"[yellow]{leg.title}: no error is predicted: {record.reason}[/]")
        return
    parts = [f"{leg.title}: {error_range(record.predicted, leg.unit)} expected"]
    baseline = foresight.ways[0].predicted
    if len(foresight.ways) > 1 and baseline is not None:
        parts.append(f"the baseline leaves {error_range(baseline, leg.unit)}")
    run.console.print(", ".join(parts))
