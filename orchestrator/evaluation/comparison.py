"""Compares the distances that were estimated with the errors of the flights that followed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from nufleet.orchestrator.evaluation.results import (
    BaselineResult,
    ByAxisResult,
    EvaluationResult,
    FlightRecord,
    SourceResult,
)
from nufleet.orchestrator.evaluation.summaries import kendall_tau
from nufleet.orchestrator.evaluation.ways import (
    coverage_of,
    inverse_result,
    points_of,
    ways_of,
    worse_than_baseline,
)
from nufleet.orchestrator.flights.labels import BASELINE, BY_AXIS, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.predicted_errors import PredictedRms
from nufleet.orchestrator.study.source_by_axis import sources_by_axis
from nufleet.shared.experience.layout import Architecture


@dataclass(frozen=True)
class Psi:
    """The estimated distance of a source from the target, ψ̂*_n, over repeated studies."""

    mean: float
    """Mean over the studies, in [0, 1]."""
    std: float
    """Standard deviation over the studies."""


def order_of(psi: Mapping[str, Psi], ranking: Sequence[SourceEstimate]) -> list[str]:
    """Return the sources, the selected one first.

    Args:
        psi: Estimated distance of each source on the first axis, by name.
        ranking: Estimates of a ranking, the selected source first; where it compared several axes,
            its order counts, and sources that it lost come last.
    """
    places = {one.robot: place for place, one in enumerate(ranking) if one.axes is not None}
    return sorted(psi, key=lambda source: (places.get(source, len(places)), psi[source].mean))


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
    ranking: Sequence[SourceEstimate] = (),
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
        ranking: Estimates of a ranking, the selected source first; they order the sources where
            they are over several axes.

    Returns:
        The errors of all inverses and their rank correlation with the predictions; the first source
        is the one selected.
    """
    ranked = {one.robot: one for one in ranking if one.axes is not None}
    order = order_of(psi, ranking)
    first = [flight for flight in flights if flight.beyond_tests_s == 0]
    baseline = [flight for flight in first if flight.inverse == BASELINE]
    of = {
        name: inverse_result([f for f in first if f.inverse == name], baseline)
        for name in (BASELINE, NO_PRIOR, OWN, MIXTURE, BY_AXIS, *order)
    }
    ways = ways_of(flights)
    points = points_of(ways, flights)
    worse = worse_than_baseline(flights)
    chosen_way = points[0].chosen_way if points else None
    noise = [f.noise_rms_m for f in baseline if f.noise_rms_m is not None and f.failure is None]
    sources = tuple(
        SourceResult(
            robot=source,
            psi=psi[source].mean,
            psi_std=psi[source].std,
            predicted_rms_m=None if predicted is None else predicted.of[source],
            ranked=ranked.get(source),
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
        mixture=of[MIXTURE] if any(flight.inverse == MIXTURE for flight in first) else None,
        by_axis=ByAxisResult(sources=sources_by_axis(ranking), **of[BY_AXIS].model_dump())
        if any(flight.inverse == BY_AXIS for flight in first)
        else None,
        own=of[OWN] if any(flight.inverse == OWN for flight in first) else None,
        sources=sources,
        selected=order[0],
        kendall_tau=kendall_tau([s.distance for s in sources], measured),
        kendall_tau_trajectory=None
        if predicted is None
        else kendall_tau([predicted.of[s.robot] for s in sources], measured),
        ways=ways,
        points=points,
        chosen_way=chosen_way,
        regret_m=points[0].regret_m if points else None,
        noise_rms_m=sum(noise) / len(noise) if noise else None,
        worse_than_baseline=len(worse),
        chosen_worse_than_baseline=sum(
            f.inverse == chosen_way and f.beyond_tests_s == 0 for f in worse
        ),
        coverage=coverage_of(flights),
        run=run,
    )
