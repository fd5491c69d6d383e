"""Summaries of an evaluation: result, scatter of the estimates, error reduction, Kendall's τ."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.evaluation.results import (
    BaselineResult,
    EvaluationResult,
    FlightRecord,
    SourceResult,
)
from nufleet.orchestrator.evaluation.values import FlightError, TransferPair
from nufleet.orchestrator.evaluation.ways import (
    coverage_of,
    inverse_result,
    points_of,
    ways_of,
    worse_than_baseline,
)
from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.orchestrator.study.predicted_errors import PredictedRms
from nufleet.shared.experience.layout import Architecture


@dataclass(frozen=True)
class Psi:
    """The estimated distance of a source from the target, ψ̂*_n, over repeated studies."""

    mean: float
    """Mean over the studies, in [0, 1]."""
    std: float
    """Standard deviation over the studies."""


def by_source(estimates: Iterable[Mapping[str, float]]) -> dict[str, list[float]]:
    """Return each source's estimates ψ̂*_n, one for each study that kept the source to its end.

    Args:
        estimates: Estimates by source, of several studies of one target (paper, eq. 10).
    """
    found: dict[str, list[float]] = {}
    for study in estimates:
        for source, psi in study.items():
            found.setdefault(source, []).append(psi)
    return found


def reduction(errors: Sequence[FlightError], prior: str) -> float | None:
    """Return the fraction by which a prior lowers the baseline's error, averaged over the paths.

    This is the "% Red." of the paper's Table I, as a fraction: 1 − mean(e_prior / e_baseline), a
    mean of ratios and not a ratio of means, so that a long path counts no more than a short one.

    Args:
        errors: Flights of one target, including those with the baseline.
        prior: Source of the prior, or `NO_PRIOR` for the zero prior.

    Returns:
        The fraction, negative when the prior made the error larger. None when no path was finished
        both with the prior and with the baseline, or when one was not finished with the prior.
    """
    before = {(e.drawing, e.speed_m_s): e.rms_error_m for e in errors if e.prior == BASELINE}
    ratios = [
        e.rms_error_m / before[e.drawing, e.speed_m_s]
        for e in errors
        if e.prior == prior and 0 < before.get((e.drawing, e.speed_m_s), 0.0) < np.inf
    ]
    # An unfinished flight has an infinite error, which no mean can include.
    return 1 - float(np.mean(ratios)) if ratios and np.isfinite(ratios).all() else None


def kendall_tau(predicted: Sequence[float], measured: Sequence[float]) -> float | None:
    """Return the rank correlation of predictions and measurements, Kendall's τ-b (Kendall 1945).

    Args:
        predicted: Predicted value of each item.
        measured: Measured value of each item, in the same order and of the same length.

    Returns:
        τ-b in [−1, 1]; ties are corrected for. None when either sequence holds fewer than two
        distinct values, since it then orders nothing.
    """
    from scipy.stats import kendalltau

    if len(set(predicted)) < 2 or len(set(measured)) < 2:
        return None
    return float(kendalltau(predicted, measured).statistic)


def pooled_kendall_tau(pairs: Sequence[TransferPair]) -> float | None:
    """Return Kendall's τ-b between ψ̂* and the error ratio, over all pairs together.

    Returns:
        τ-b in [−1, 1], or None when it is undefined; see `kendall_tau`.
    """
    return kendall_tau([pair.psi for pair in pairs], [pair.ratio for pair in pairs])


def mean_kendall_tau(pairs: Sequence[TransferPair]) -> float | None:
    """Return Kendall's τ-b between ψ̂* and the error ratio, averaged over the targets.

    A selection only ever compares sources of the same target, so τ is computed within each target
    before averaging.

    Returns:
        Mean τ-b in [−1, 1] over the targets for which it is defined; None when there are none.
    """
    targets = sorted({pair.target for pair in pairs})
    taus = [pooled_kendall_tau([pair for pair in pairs if pair.target == t]) for t in targets]
    known = [tau for tau in taus if tau is not None]
    return float(np.mean(known)) if known else None


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
    first = [flight for flight in flights if flight.beyond_tests_s == 0]
    baseline = [flight for flight in first if flight.inverse == BASELINE]
    of = {
        name: inverse_result([f for f in first if f.inverse == name], baseline)
        for name in (BASELINE, NO_PRIOR, OWN, MIXTURE, *order)
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
        own=of[OWN] if any(flight.inverse == OWN for flight in first) else None,
        sources=sources,
        selected=order[0],
        kendall_tau=kendall_tau([s.psi for s in sources], measured),
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
