"""The ways to fly: what each of them left, what was predicted, and which to choose."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence

import numpy as np

from nufleet.orchestrator.evaluation.results import (
    CurvePoint,
    FlightRecord,
    IntervalCoverage,
    InverseResult,
    WayResult,
)
from nufleet.orchestrator.flights.labels import BASELINE
from nufleet.shared.arrays import FloatArray

_MEDIAN_OF_NORMAL = 0.6745  # median of |x| for a standard normal x


def inverse_result(
    flights: Sequence[FlightRecord], baseline: Sequence[FlightRecord]
) -> InverseResult:
    """Return the errors of flights with one inverse, compared with those of the baseline.

    Args:
        flights: Flights with the inverse, each along another path.
        baseline: Flights with the baseline along the same paths.
    """
    own = {_path(f): f.rms_m for f in baseline}
    errors = [f.rms_m for f in flights]
    finished = [error for error in errors if error is not None]
    known = [error for error in own.values() if error is not None]
    rms = float(np.mean(finished)) if finished and len(finished) == len(errors) else None
    reduction = None
    # Both means must cover the same paths: means over different paths cannot be compared.
    if rms is not None and len(known) == len(own) and any(known):
        reduction = 100.0 * (1.0 - rms / float(np.mean(known)))
    ratios = [
        f.rms_m / base for f in flights if f.rms_m is not None and (base := own.get(_path(f)))
    ]
    return InverseResult(
        rms_m=rms,
        reduction_percent=reduction,
        worst_ratio=max(ratios) if len(ratios) == len(flights) and ratios else None,
        taken_back=sum(f.taken_back is not None for f in flights),
        not_flown=sum(not f.flown for f in flights),
    )


def ways_of(flights: Sequence[FlightRecord]) -> tuple[WayResult, ...]:
    """Return the errors and predictions of every way, in the order in which they were flown."""
    baseline = [f for f in flights if f.inverse == BASELINE]
    groups: dict[tuple[str, float], list[FlightRecord]] = {}
    for flight in flights:
        groups.setdefault((flight.inverse, flight.beyond_tests_s), []).append(flight)
    return tuple(
        WayResult(
            way=way,
            own_flight_s=own_s,
            predicted_rms_m=_mean(f.predicted_rms_m for f in mine),
            predicted_low_m=_mean(f.predicted_low_m for f in mine),
            predicted_high_m=_mean(f.predicted_high_m for f in mine),
            **inverse_result(mine, baseline).model_dump(),
        )
        for (way, own_s), mine in groups.items()
    )


def points_of(ways: Sequence[WayResult], flights: Sequence[FlightRecord]) -> tuple[CurvePoint, ...]:
    """Return what the predictions choose after each duration of own flying, and what it cost.

    A way that was not flown again competes with the prediction and the error of its last flights.

    Args:
        ways: Errors and predictions of every way.
        flights: The flights themselves.
    """
    points = []
    for own_s in sorted({way.own_flight_s for way in ways}):
        latest = {way.way: way for way in ways if way.own_flight_s <= own_s}
        known = [f.own_flight_s for f in flights if f.beyond_tests_s == own_s]
        chosen = chosen_of(latest.values())
        flown = [way.rms_m for way in latest.values() if way.rms_m is not None]
        points.append(
            CurvePoint(
                own_flight_s=own_s,
                known_s=max((s for s in known if s is not None), default=None),
                chosen_way=None if chosen is None else chosen.way,
                regret_m=None
                if chosen is None or chosen.rms_m is None
                else chosen.rms_m - min(flown),
            )
        )
    return tuple(points)


def chosen_of(ways: Iterable[WayResult]) -> WayResult | None:
    """Return the way with the least predicted error; None when nothing was predicted."""
    predicted = [way for way in ways if way.predicted_rms_m is not None]
    return min(predicted, key=lambda way: way.predicted_rms_m or 0.0, default=None)


def coverage_of(flights: Iterable[FlightRecord]) -> dict[str, IntervalCoverage]:
    """Return how often the predicted intervals contained the error of the flight, by way."""
    held: dict[str, list[bool]] = {}
    for f in flights:
        if f.rms_m is None or f.predicted_low_m is None or f.predicted_high_m is None:
            continue
        held.setdefault(f.inverse, []).append(f.predicted_low_m <= f.rms_m <= f.predicted_high_m)
    return {
        way: IntervalCoverage(flights=len(each), inside=sum(each)) for way, each in held.items()
    }


def worse_than_baseline(flights: Sequence[FlightRecord]) -> list[FlightRecord]:
    """Return the flights that left more error than the baseline, or none at all to compare.

    A flight that was not finished is worse than a baseline that was. One that the target refused
    to begin was not flown.
    """
    base = {_path(f): f.rms_m for f in flights if f.inverse == BASELINE}
    return [
        f
        for f in flights
        if f.inverse != BASELINE
        and f.flown
        and (before := base.get(_path(f))) is not None
        and (math.inf if f.rms_m is None else f.rms_m) > before
    ]


def sensor_noise_rms(actual: FloatArray) -> float:
    """Return the RMS error that white noise of a position sensor alone would leave.

    The third difference of a motion that is smooth from sample to sample is small, while that of
    white noise of variance σ² has the variance 20 σ². Its median is insensitive to spikes.

    Args:
        actual: Measured positions, shape (samples, axes), at least four samples.
    """
    thirds = np.abs(np.diff(actual, 3, axis=0))
    sigma = np.median(thirds, axis=0) / _MEDIAN_OF_NORMAL / math.sqrt(20.0)
    return float(np.linalg.norm(sigma))


def _path(flight: FlightRecord) -> tuple[str, float]:
    return flight.drawing, flight.speed_m_s


def _mean(values: Iterable[float | None]) -> float | None:
    every = list(values)
    known = [value for value in every if value is not None]
    return float(np.mean(known)) if known and len(known) == len(every) else None
