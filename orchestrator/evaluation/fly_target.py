"""Flies a target along drawings with every source's experience, with none, and with its baseline.

Everything is decided before the flights: each experience on its own robot, and the order of the
sources by frequency tests. The flights only show whether the prediction was right.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol

import numpy as np

from nufleet.orchestrator.evaluation.results import (
    BaselineResult,
    EvaluationResult,
    FlightRecord,
    InverseResult,
    SourceResult,
)
from nufleet.orchestrator.evaluation.summaries import kendall_tau
from nufleet.orchestrator.experience.learning import pick_up
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.prior_custody import prior_put_back
from nufleet.orchestrator.experience.transfer import transfer, transfer_several
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import PathFlight, Pilot
from nufleet.orchestrator.flights.start_weights import mixture_of
from nufleet.orchestrator.study.predicted_errors import PredictedRms
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RefusedError
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.motions import MIXTURE_MAX

NO_OWN_MODEL = ("no-own-model", "vague-own-model")
"""Codes of the refusals of a robot that knows too little of itself for a path."""


class FlightObserver(Protocol):
    """An observer of flights, called from the thread that conducts the evaluation."""

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """Handle the beginning of a flight of a robot, under the label that names it."""

    def ended(self, flight: PathFlight) -> None:
        """Handle the end of the flight, given its measurements."""


@dataclass(frozen=True)
class Psi:
    """The estimated distance of a source from the target, ψ̂*_n, over repeated studies."""

    mean: float
    """Mean over the studies, in [0, 1]."""
    std: float
    """Standard deviation over the studies."""


def fly_target(
    fleet: Fleet,
    pilot: Pilot,
    library: ExperienceLibrary,
    target: Description,
    sources: Sequence[str],
    legs: Sequence[Leg],
    architecture: Architecture,
    *,
    guarded: bool,
    observers: Sequence[FlightObserver],
    psi: Mapping[str, float] | None = None,
) -> tuple[FlightRecord, ...]:
    """Fly a target along all legs: own model, baseline, zero prior, every source, their mixture.

    Its own model is flown first, since every flight adds to it: on the first path it rests on the
    tests alone. A path that the target's model of itself is too vague for is not flown with it.
    Afterwards the target again holds the prior that it held before.

    Args:
        fleet: Client of the fleet, already connected.
        pilot: Pilot that has the target fly.
        library: Experiences of the fleet's robots, those of the sources among them.
        target: Description of the robot that flies.
        sources: Names of the sources. The zero prior takes the layout of the first one, so the
            selected source comes first.
        legs: Paths to fly with every inverse.
        architecture: Architecture of the sources' experiences to transfer.
        guarded: Whether the guard may withdraw a prior in flight.
        observers: Callbacks for the beginning and the end of each flight.
        psi: Estimated distance of the sources, from which the mixture's weights start; None to
            start from equal ones.

    Returns:
        One record per flight, in the order in which they were flown.

    Raises:
        RobotError: A real robot failed and needs a person's attention.
        RefusedError: The target refuses a flight, for example because its baseline is not known.
    """
    flights: list[FlightRecord] = []
    robot = target.robot

    def fly_legs(inverse: str, fly: Callable[[FloatArray, str], PathFlight]) -> None:
        for leg in legs:
            label = leg.label(inverse)
            for observer in observers:
                observer.begins(robot, label, target.spec)
            known_s = fleet.describe(robot).least_known_s
            try:
                flight = fly(leg.desired, label)
            except RefusedError as error:
                if error.code not in NO_OWN_MODEL:
                    raise
                flights.append(_not_flown(robot, inverse, leg, error.reason))
                continue
            for observer in observers:
                observer.ended(flight)
            if flight.failure is not None:
                pick_up(fleet, target, flight.failure)
            flights.append(flight_record(flight, inverse, leg, known_s))

    fly_legs(OWN, partial(pilot.own, robot, guarded=guarded))
    fly_legs(BASELINE, partial(pilot.baseline, robot))
    with prior_put_back(fleet, pilot, target):
        for place, source in enumerate(sources):
            given = transfer(fleet, library, source, target, architecture)
            if place == 0:
                layout = given.manifest.layout
                fly_legs(NO_PRIOR, partial(pilot.zero_prior, robot, layout=layout, guarded=guarded))
            with_prior = partial(pilot.with_prior, robot, sha256=given.sha256, guarded=guarded)
            fly_legs(source, with_prior)
        mixed = sources[:MIXTURE_MAX]
        transfer_several(fleet, library, mixed, target, architecture)
        mixture = mixture_of(fleet.describe(robot).priors, psi)
        fly_legs(MIXTURE, partial(pilot.with_mixture, robot, mixture=mixture, guarded=guarded))
    return tuple(flights)


def _not_flown(robot: str, inverse: str, leg: Leg, reason: str) -> FlightRecord:
    return FlightRecord(
        target=robot,
        inverse=inverse,
        drawing=leg.drawing,
        speed_m_s=leg.speed,
        rms_m=None,
        taken_back=None,
        failure=f"not flown: {reason}",
        deadline_misses=0,
    )


def flight_record(
    flight: PathFlight, inverse: str, leg: Leg, own_flight_s: float | None = None
) -> FlightRecord:
    """Return the record of a flight along a leg with the named inverse.

    Args:
        flight: The flight, as it was flown.
        inverse: Name of the source, BASELINE, NO_PRIOR or OWN.
        leg: Path of the flight.
        own_flight_s: Duration of the motions by which the robot knew itself before.
    """
    event, predicted = flight.details.taken_back, flight.details.predicted
    return FlightRecord(
        target=flight.robot,
        inverse=inverse,
        drawing=leg.drawing,
        speed_m_s=leg.speed,
        rms_m=None if flight.failure is not None else flight.rms_error,
        taken_back=None if event is None else event.reason,
        failure=flight.failure,
        deadline_misses=flight.deadline_misses,
        weights=flight.mean_weights,
        own_flight_s=own_flight_s,
        predicted_rms_m=None if predicted is None else predicted.rms,
        predicted_low_m=None if predicted is None else predicted.low,
        predicted_high_m=None if predicted is None else predicted.high,
        findings=flight.details.findings,
    )


def summarise(
    target: str,
    flights: Sequence[FlightRecord],
    psi: Mapping[str, Psi],
    architecture: Architecture,
    *,
    unit: str,
    guarded: bool,
    run: str,
    predicted: PredictedRms | None = None,
) -> EvaluationResult:
    """Compare the predicted distances and errors with the errors of the flights.

    Args:
        target: Name of the robot that flew.
        flights: Flights of that target, with every inverse on the same paths.
        psi: Estimated distance of each source, by name.
        architecture: Architecture of the sources' experiences.
        unit: Unit of the target's axes, "m" or "rad".
        guarded: Whether the guard was active in these flights.
        run: Path of the run's folder.
        predicted: RMS errors that the tests predict for these paths; None when not computed.

    Returns:
        The errors of all inverses and their rank correlation with the predictions; sources are in
        ascending order of ψ̂*, and the first of them is the one selected.
    """
    order = sorted(psi, key=lambda source: psi[source].mean)
    of = {
        name: _inverse_result(flights, name) for name in (BASELINE, NO_PRIOR, OWN, MIXTURE, *order)
    }
    sources = tuple(
        SourceResult(
            robot=source,
            psi=psi[source].mean,
            psi_std=psi[source].std,
            predicted_rms_m=None if predicted is None else predicted.of[source],
            **of[source].model_dump(),
        )
        for source in order
    )
    measured = [math.inf if s.rms_m is None else s.rms_m for s in sources]
    return EvaluationResult(
        target=target,
        architecture=architecture,
        unit="rad" if unit == "rad" else "m",
        guarded=guarded,
        baseline=BaselineResult(
            rms_m=of[BASELINE].rms_m,
            predicted_rms_m=None if predicted is None else predicted.without,
        ),
        no_prior=of[NO_PRIOR],
        mixture=of[MIXTURE] if any(flight.inverse == MIXTURE for flight in flights) else None,
        own=of[OWN] if any(flight.inverse == OWN for flight in flights) else None,
        sources=sources,
        selected=order[0],
        kendall_tau=kendall_tau([s.psi for s in sources], measured),
        kendall_tau_trajectory=None
        if predicted is None
        else kendall_tau([predicted.of[s.robot] for s in sources], measured),
        run=run,
    )


def _inverse_result(flights: Sequence[FlightRecord], inverse: str) -> InverseResult:
    mine = {(f.drawing, f.speed_m_s): f for f in flights if f.inverse == inverse}
    own = {(f.drawing, f.speed_m_s): f.rms_m for f in flights if f.inverse == BASELINE}
    errors = [f.rms_m for f in mine.values()]
    finished = [error for error in errors if error is not None]
    baseline = [error for error in own.values() if error is not None]
    rms = float(np.mean(finished)) if finished and len(finished) == len(errors) else None
    reduction = None
    # Both means must cover the same paths: means over different paths cannot be compared.
    if rms is not None and inverse != BASELINE and len(baseline) == len(own) and any(baseline):
        reduction = 100.0 * (1.0 - rms / float(np.mean(baseline)))
    ratios = [
        f.rms_m / base
        for path, f in mine.items()
        if f.rms_m is not None and (base := own.get(path))
    ]
    return InverseResult(
        rms_m=rms,
        reduction_percent=reduction,
        worst_ratio=max(ratios) if len(ratios) == len(mine) and ratios else None,
        taken_back=sum(f.taken_back is not None for f in mine.values()),
    )
