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
            predicted_rms_m=None if predicted is None else predicted.of.get(source),
            ranked=ranked.get(source),
            **of[source].model_dump(),
        )
        for source in order
    )
    measured = [math.inf if s.rms_m is None else s.rms_m for s in sources]
    expected = {s.robot: s.predicted_rms_m for s in sources if s.predicted_rms_m is not None}
    by_axis = None
    if any(flight.inverse == BY_AXIS for flight in first):
        by_axis = ByAxisResult(
            sources=sources_by_axis(ranking),
            predicted_rms_m=None if predicted is None else predicted.by_axis,
            **of[BY_AXIS].model_dump(),
        )
    each: dict[str, SourceResult | ByAxisResult] = {s.robot: s for s in sources}
    if by_axis is not None:
        each[BY_AXIS] = by_axis
    least, regret_m = _least_expected(each)
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
        by_axis=by_axis,
        own=of[OWN] if any(flight.inverse == OWN for flight in first) else None,
        sources=sources,
        selected=order[0],
        kendall_tau=kendall_tau([s.distance for s in sources], measured),
        kendall_tau_trajectory=None
        if predicted is None
        else kendall_tau(
            list(expected.values()),
            [error for s, error in zip(sources, measured, strict=True) if s.robot in expected],
        ),
        predicted_axes=() if predicted is None else predicted.axes,
        least_expected=least,
        least_expected_regret_m=regret_m,
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


def _least_expected(
    each: Mapping[str, SourceResult | ByAxisResult],
) -> tuple[str | None, float | None]:
    """Return the experience with the least predicted error, and what it left beyond the least."""
    expected = {
        n: one.predicted_rms_m for n, one in each.items() if one.predicted_rms_m is not None
    }
    if not expected:
        return None, None
    least = min(expected, key=lambda name: expected[name])
    flown, left = [one.rms_m for one in each.values() if one.rms_m is not None], each[least].rms_m
    return least, None if left is None or len(flown) < len(each) else left - min(flown)
