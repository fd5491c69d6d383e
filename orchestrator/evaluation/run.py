"""One `nufleet evaluate` on a connected fleet: learn, rank, fly, compare, report."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.rank_run import ReadyStudy
from nufleet.orchestrator.evaluation.fly_target import FlightObserver, fly_target, summarise
from nufleet.orchestrator.evaluation.repeated_studies import psi_of, repeat_study
from nufleet.orchestrator.evaluation.results import EVALUATION, EvaluationRecord
from nufleet.orchestrator.experience.learning import FLIGHT_S, know_itself
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.train import Trained, train_robots
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.study.predicted_errors import predict_rms
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
    prepare_robots(fleet, pilot, library, plan, folder, say=say)
    run_id = folder.path.name.lower()
    studies = repeat_study(
        fleet,
        plan.ready,
        plan.seeds,
        run_id,
        archive,
        on_study=lambda study: say(f"study {study.seed}: " + ranking_line(study.last)),
    )
    psi = psi_of(studies.estimates)
    order = sorted(psi, key=lambda source: psi[source].mean)
    predicted = predict_rms(
        study.target,
        order,
        {robot: description.spec for robot, description in plan.ready.descriptions.items()},
        studies.responses,
        [leg.desired for leg in plan.legs],
        np.random.default_rng(plan.seed),
        omega_max_rad_s=study.band_rad_s[1],
    )
    know_itself(fleet, pilot, study.target, seed=plan.seed, say=say)
    target = fleet.describe(study.target)
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
        psi={source: psi[source].mean for source in order},
    )
    pilot.acknowledge_all()
    result = summarise(
        study.target,
        flights,
        psi,
        plan.architecture,
        predicted=predicted,
        unit=target.spec.axis(study.axis).unit,
        guarded=plan.guarded,
        run=str(folder.path),
    )
    record = EvaluationRecord(
        result=result,
        studies=studies.estimates,
        flights=flights,
        wall_time_s=time.monotonic() - began_s,
    )
    folder.write_document(EVALUATION, record)
    return record


def prepare_robots(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    plan: EvaluationPlan,
    folder: RunFolder,
    *,
    say: Say,
) -> None:
    """Train the experiences that sources lack; for the arguments and errors, see `run_evaluation`.

    The target needs no flight: its guard knows its baseline from the tests.
    """
    study = plan.ready.plan
    with ThreadPoolExecutor(8, thread_name_prefix="describe") as pool:
        sources = tuple(pool.map(fleet.describe, study.sources))
    lacking = [source for source in sources if not _has(source, plan.architecture)]
    if not lacking:
        return
    say(f"{', '.join(source.robot for source in lacking)}: experiences are flown and trained")
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


def _has(description: Description, architecture: Architecture) -> bool:
    return any(
        offer.manifest.layout.architecture == architecture for offer in description.experiences
    )
