"""One `nufleet evaluate` on a connected fleet: learn, rank, fly, compare, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.conductor import Conclusion
from nufleet.orchestrator.conduct.rank_run import ReadyStudy
from nufleet.orchestrator.evaluation.comparison import order_of, summarise
from nufleet.orchestrator.evaluation.fly_target import (
    FlightObserver,
    flights_planned,
    fly_target,
    held_by_axis,
)
from nufleet.orchestrator.evaluation.kept_records import KeptRecords, read_records
from nufleet.orchestrator.evaluation.repeated_studies import (
    has_begun,
    psi_of,
    rank_once,
    repeat_study,
)
from nufleet.orchestrator.evaluation.results import EVALUATION, EvaluationRecord, FlightRecord
from nufleet.orchestrator.experience.learning import FLIGHT_S, know_itself
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.train import Trained, train_robots
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.runs.folder import RunFolder, read_document
from nufleet.orchestrator.study.predicted_errors import predict_rms
from nufleet.orchestrator.study.source_by_axis import in_words
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description

Say = Callable[[str], None]


@dataclass(frozen=True, eq=False)
class EvaluationPlan:
    """The plan of an evaluation of one target."""

    ready: ReadyStudy
    """Study that ranks the sources, prepared and checked."""
    legs: Sequence[Leg]
    """Paths that are flown with every inverse."""
    architecture: Architecture
    """Architecture of the experiences to compare."""
    seeds: Sequence[int]
    """Seeds of the repeated studies."""
    seed: int
    """Seed of the learning flights, of the networks' first weights and of the predictions."""
    guarded: bool = True
    """Whether the guard may withdraw a prior in flight."""
    flight_s: float = FLIGHT_S
    """Duration of each flight that a robot learns from."""
    own_flight_s: Sequence[float] = (0.0,)
    """Durations of the target's own flying beyond its tests, rising from 0, after each of which it
    flies with its model of itself."""
    forget: bool = False
    """Whether the target first forgets what it knows of itself; for robots started for this run."""


def run_evaluation(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    plan: EvaluationPlan,
    folder: RunFolder,
    archive: Archive,
    *,
    say: Say,
    observers: Sequence[FlightObserver],
) -> EvaluationRecord:
    """Evaluate one target; experiences that sources do not have yet are trained first.

    What an interrupted evaluation left in the folder and in the repository is not done again: the
    experiences, the studies and the flights.

    Args:
        fleet: Client of the fleet, already connected.
        pilot: Pilot that has the robots fly.
        library: Experiences of the fleet's robots; those that are trained are stored in it.
        plan: Target, sources, paths and seeds.
        folder: Folder of the run; experiences and the result are written there.
        archive: Repository that stores the studies, with the leases on the robots.
        say: Callback that receives one line of progress at a time.
        observers: Callbacks for the beginning and the end of each flight along a path.

    Returns:
        The result with all studies and flights, as written to the run's folder.

    Raises:
        StudyError, RobotError, RefusedError: See `train_robots`, `repeat_study`, `fly_target`.
    """
    began_s = time.monotonic()
    study = plan.ready.plan
    kept = [record for record in read_records(folder.path) if record.target == study.target]
    before_s = _wall_time_s(folder, study.target)
    prepare_robots(fleet, pilot, library, plan, study.sources, folder, say=say)
    run_id = folder.path.name.lower()
    # The paper's algorithm compares robots by one axis.
    first_axis = replace(plan.ready, plan=replace(study, also=()))
    studies = repeat_study(
        fleet,
        first_axis,
        plan.seeds,
        run_id,
        archive,
        on_study=lambda study: say(f"study {study.seed}: " + ranking_line(study.last)),
    )
    psi = psi_of(studies.estimates)
    ranked = _tested(fleet, plan, run_id, archive, say=say)
    ranking = ranked.report.ranking
    order = order_of(psi, ranking)
    by_axis = held_by_axis(ranking, order)
    measured = (studies.responses, ranked.responses)
    predicted = predict_rms(
        study.target,
        order,
        {robot: description.spec for robot, description in plan.ready.descriptions.items()},
        {robot: [r for of in measured for r in of.get(robot, ())] for robot in studies.responses},
        [leg.desired for leg in plan.legs],
        np.random.default_rng(plan.seed),
        omega_max_rad_s=study.band_rad_s[1],
        axes=study.axes,
        by_axis=by_axis,
    )
    know_itself(fleet, pilot, study.target, seed=plan.seed, say=say)
    target = fleet.describe(study.target)
    if by_axis:
        say(f"axes differ in their closest source: {in_words(by_axis, ranking)}")
    planned = flights_planned(
        len(order), len(plan.legs), len(plan.own_flight_s), by_axis=bool(by_axis)
    )

    def keep(flights: Sequence[FlightRecord]) -> EvaluationRecord:
        result = summarise(
            study.target,
            flights,
            psi,
            plan.architecture,
            predicted=predicted,
            ranking=ranking,
            unit=target.spec.axis(study.axis).unit,
            guarded=plan.guarded,
            run=str(folder.path),
        )
        record = EvaluationRecord(
            result=result,
            studies=studies.estimates,
            flights=tuple(flights),
            wall_time_s=before_s + time.monotonic() - began_s,
            complete=len(flights) >= planned,
        )
        folder.write_document(EVALUATION, record)
        return record

    if kept:
        say(f"{len(kept)} of {planned} flights of {study.target} were flown before")
    with KeptRecords(folder.path, planned, len(kept), say=say, on_point=keep) as log:
        flights = fly_target(
            fleet,
            pilot,
            library,
            target,
            order,
            plan.legs,
            plan.architecture,
            guarded=plan.guarded,
            observers=observers,
            psi={estimate.robot: estimate.psi for estimate in ranking},
            ranking=ranking,
            own_flight_s=plan.own_flight_s,
            seed=plan.seed,
            rehearse=True,
            log=log,
            done=kept,
        )
    pilot.acknowledge_all()
    return keep(flights)


def _tested(
    fleet: Fleet, plan: EvaluationPlan, run_id: str, archive: Archive, *, say: Say
) -> Conclusion:
    """Have the target know of itself what one ranking shows, and return how that ended."""
    study = plan.ready.plan
    if plan.forget and not has_begun(study.target, run_id, archive):
        fleet.forget_own_model(study.target)
    conclusion = rank_once(fleet, plan.ready, plan.seed, run_id, archive)
    ranking = conclusion.report.ranking
    target = fleet.describe(study.target)
    known = ", ".join(
        f"{axis.name} {target.own_flight_s.get(axis.name, 0.0):.0f} s" for axis in target.spec.axes
    )
    say(
        "ranked as by `nufleet rank`: "
        + ranking_line({estimate.robot: estimate.psi for estimate in ranking})
        + f"; {study.target} knows itself from "
        f"its tests{'' if plan.forget else ' and earlier motions'}: {known}"
    )
    return conclusion


def _wall_time_s(folder: RunFolder, target: str) -> float:
    """Return how long an interrupted evaluation of a target took until its last point, in s."""
    record = read_document(folder.path / EVALUATION, EvaluationRecord)
    return record.wall_time_s if record is not None and record.result.target == target else 0.0


def prepare_robots(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    plan: EvaluationPlan,
    robots: Iterable[str],
    folder: RunFolder,
    *,
    say: Say,
) -> None:
    """Train the experiences that robots lack; for other arguments and errors: `run_evaluation`.

    The target of a single evaluation needs none: its guard knows its baseline from the tests.

    Args:
        robots: Names of the robots that are to have one.
    """
    with ThreadPoolExecutor(8, thread_name_prefix="describe") as pool:
        there = tuple(pool.map(fleet.describe, robots))
    lacking = [one for one in there if not has_experience(one, plan.architecture)]
    if not lacking:
        return
    say(f"{', '.join(one.robot for one in lacking)}: experiences are flown and trained")
    keep = library.keeping(lacking, folder.path.name)

    def on_trained(trained: Trained) -> None:
        keep(trained)
        horizon_s = trained.lesson.choice.layout.horizon_s
        say(
            f"  {trained.lesson.robot}: horizon {horizon_s:.2f} s, "
            f"trained in {trained.training_time_s:.1f} s"
        )

    train_robots(
        fleet,
        pilot,
        lacking,
        (plan.architecture,),
        folder.path / "experiences",
        seed=plan.seed,
        duration_s=plan.flight_s,
        say=lambda robot, what: None,
        on_trained=on_trained,
    )


def ranking_line(psi: dict[str, float]) -> str:
    """Return sources and their ψ̂*_n in one line, the closest first."""
    ordered = sorted(psi.items(), key=lambda item: item[1])
    return ", ".join(f"{source} {value:.3f}" for source, value in ordered)


def has_experience(description: Description, architecture: Architecture) -> bool:
    """Return whether a robot has learned an experience of an architecture."""
    return any(
        offer.manifest.layout.architecture == architecture for offer in description.experiences
    )
