"""The whole workflow on one drawing: rank, learn, transfer, track, compare with the prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from nufleet.orchestrator.evaluation.comparison import Psi, summarise
from nufleet.orchestrator.evaluation.flight_documents import DEMONSTRATION, DemoResult
from nufleet.orchestrator.evaluation.fly_target import (
    FlightObserver,
    flight_record,
    fly_target,
)
from nufleet.orchestrator.evaluation.results import FlightRecord
from nufleet.orchestrator.experience.learning import know_itself
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.prior_custody import prior_put_back
from nufleet.orchestrator.experience.train import Trained, train_robots
from nufleet.orchestrator.experience.transfer import transfer
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.labels import without_guard
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.rank_result import RunRecord
from nufleet.orchestrator.study.predicted_errors import PredictedRms, predict_rms
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.motions import Way


def demonstrate(
    fleet: Fleet,
    pilot: Pilot,
    target: Description,
    record: RunRecord,
    leg: Leg,
    architecture: Architecture,
    folder: RunFolder,
    *,
    seed: int,
    flight_s: float,
    say: Callable[[str], None],
    observers: Sequence[FlightObserver],
) -> DemoResult:
    """Have the closest and the furthest source learn, and fly the target in every way.

    If the guard takes the furthest source's experience back, the flight is repeated without the
    guard, which shows what it prevented.

    Args:
        fleet: Client of the fleet, already connected; all its robots are simulated.
        pilot: Pilot that has the robots fly.
        target: Description of the robot that needs experience.
        record: Ranking of the sources by frequency tests, the closest first, and these tests.
        leg: Path that the target flies in every way.
        architecture: Architecture of the experiences that the sources learn.
        folder: Folder of the run; experiences and the result are written there.
        seed: Seed of the learning flights, of the networks' first weights and of the predictions.
        flight_s: Duration in s of each flight that a robot learns from.
        say: Callback that receives one line of progress at a time.
        observers: Callbacks for the beginning and the end of each flight along a path.

    Returns:
        The ranking together with the errors of the flights, as written to the run's folder.
    """
    ranking = record.result
    best, worst = ranking.ranking[0], ranking.ranking[-1]
    chosen = {estimate.robot: estimate for estimate in (best, worst)}
    learners = [fleet.describe(source) for source in chosen]
    predicted = None
    if architecture == "preview":  # an inverse of the state forms a loop that tests do not predict
        predicted = _predicted(target, learners, record, leg, seed)
        for source in chosen:
            say(
                f"{source}: from the tests, its experience is expected to leave "
                f"{_milli(predicted.of[source], leg.unit)} of error, instead of "
                f"{_milli(predicted.without, leg.unit)}"
            )
    say(f"{' and '.join(chosen)} fly for {flight_s:.0f} s to learn")
    know_itself(fleet, pilot, target.robot, seed=seed, say=say)
    train_robots(
        fleet,
        pilot,
        learners,
        (architecture,),
        folder.path / "experiences",
        seed=seed,
        duration_s=flight_s,
        say=lambda robot, what: None,
        on_trained=lambda done: say(_offer(done)),
    )
    say(f"{target.robot} tracks a drawing in every way")
    library = ExperienceLibrary(fleet)
    flown = fly_target(
        fleet,
        pilot,
        library,
        target,
        list(chosen),
        [leg],
        architecture,
        guarded=True,
        observers=observers,
        psi={source: estimate.psi for source, estimate in chosen.items()},
    )
    unguarded = None
    if any(flight.inverse == worst.robot and flight.taken_back for flight in flown):
        unguarded = _without_guard(
            fleet, pilot, library, target, worst.robot, leg, architecture, observers
        )
    result = DemoResult(
        ranking=ranking,
        flights=summarise(
            target.robot,
            flown,
            {
                source: Psi(estimate.psi, (estimate.psi_high - estimate.psi_low) / 4)
                for source, estimate in chosen.items()
            },
            architecture,
            unit=leg.unit,
            guarded=True,
            run=str(folder.path),
            predicted=predicted,
        ),
        flown=flown,
        unguarded=unguarded,
        run=str(folder.path),
    )
    folder.write_document(DEMONSTRATION, result)
    return result


def _predicted(
    target: Description, sources: Sequence[Description], record: RunRecord, leg: Leg, seed: int
) -> PredictedRms:
    specs = {known.robot: known.spec for known in (target, *sources)}
    axes = tuple(record.result.ranking[0].axes or {}) or (target.spec.axes[0].name,)
    return predict_rms(
        target.robot,
        [source.robot for source in sources],
        specs,
        {robot: [test.response() for test in record.responses[robot]] for robot in specs},
        [leg.desired],
        np.random.default_rng(seed),
        omega_max_rad_s=record.result.band_rad_s[1],
        axes=axes,
    )


def _offer(done: Trained) -> str:
    manifest = done.experience.manifest
    model = "network" if manifest.hidden else "linear inverse"
    return (
        f"  {done.lesson.robot} offers its experience: a {model} with a horizon of "
        f"{manifest.layout.horizon_s:.2f} s, trained in {done.training_time_s:.1f} s"
    )


def _without_guard(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    target: Description,
    source: str,
    leg: Leg,
    architecture: Architecture,
    observers: Sequence[FlightObserver],
) -> FlightRecord:
    inverse = without_guard(source)
    label = leg.label(inverse)
    with prior_put_back(fleet, pilot, target):
        given = transfer(fleet, library, source, target, architecture)
        for observer in observers:
            observer.begins(target.robot, label, target.spec)
        way = Way(inverse="prior", prior_sha256=given.sha256, guarded=False)
        flight = pilot.along(target.robot, way, leg.desired, label)
        for observer in observers:
            observer.ended(flight)
    return flight_record(flight, inverse, leg)


def _milli(value: float, unit: str) -> str:
    return f"{1000 * value:.1f} m{unit}"
