"""Flies a target along drawings with every source's experience, with none, and with its baseline.

Everything is chosen before the flights: experiences by their own robots, the order of the sources
by frequency tests. What is flown afterwards only says whether that was right.
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
from nufleet.orchestrator.experience.prior_custody import prior_put_back
from nufleet.orchestrator.experience.transfer import transfer
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flight_labels import BASELINE, NO_PRIOR
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import PathFlight, Pilot
from nufleet.orchestrator.study.predicted_errors import PredictedRms
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import Description


class FlightObserver(Protocol):
    """Is told of each flight, from the thread that conducts the evaluation."""

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """A flight begins."""

    def ended(self, flight: PathFlight) -> None:
        """A flight ended, and this is what was measured."""


@dataclass(frozen=True)
class Psi:
    """How far a source is estimated to be from the target."""

    mean: float
    std: float


def fly_target(
    fleet: Fleet,
    pilot: Pilot,
    target: Description,
    sources: Sequence[str],
    legs: Sequence[Leg],
    architecture: Architecture,
    *,
    guarded: bool,
    observers: Sequence[FlightObserver],
) -> tuple[FlightRecord, ...]:
    """Fly a target along all legs: baseline, zero prior, then each source's experience.

    The zero prior flies with the layout of the first source, so list the one selected first. The
    target has the prior afterwards that it had before.

    Raises:
        RobotError: a real robot failed and somebody has to see to it.
        RefusedError: the target refuses a flight, for example since its baseline is not known.
    """
    flights: list[FlightRecord] = []
    robot = target.robot

    def fly_legs(inverse: str, fly: Callable[[FloatArray, str], PathFlight]) -> None:
        for leg in legs:
            label = leg.label(inverse)
            for observer in observers:
                observer.begins(robot, label, target.spec)
            flight = fly(leg.desired, label)
            for observer in observers:
                observer.ended(flight)
            if flight.failure is not None:
                pick_up(fleet, target, flight.failure)
            flights.append(flight_record(flight, inverse, leg))

    fly_legs(BASELINE, partial(pilot.baseline, robot))
    with prior_put_back(fleet, pilot, target):
        for place, source in enumerate(sources):
            given = transfer(fleet, source, robot, architecture)
            if place == 0:
                layout = given.manifest.layout
                fly_legs(NO_PRIOR, partial(pilot.zero_prior, robot, layout=layout, guarded=guarded))
            with_prior = partial(pilot.with_prior, robot, sha256=given.sha256, guarded=guarded)
            fly_legs(source, with_prior)
    return tuple(flights)


def flight_record(flight: PathFlight, inverse: str, leg: Leg) -> FlightRecord:
    """Return what is kept of a flight."""
    event = flight.details.taken_back
    return FlightRecord(
        target=flight.robot,
        inverse=inverse,
        drawing=leg.drawing,
        speed_m_s=leg.speed,
        rms_m=None if flight.failure is not None else flight.rms_error,
        taken_back=None if event is None else event.reason,
        failure=flight.failure,
        deadline_misses=flight.deadline_misses,
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
    """Compare predictions with flights.

    Args:
        target: who flew.
        flights: of that target, all inverses on the same paths.
        psi: of each source.
        architecture: of the experiences.
        unit: of the target's axes.
        guarded: whether the flights were.
        run: the run's folder.
        predicted: the errors expected on these paths.
    """
    order = sorted(psi, key=lambda source: psi[source].mean)
    of = {name: _inverse_result(flights, name) for name in (BASELINE, NO_PRIOR, *order)}
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
    # Means over different paths cannot be compared.
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
