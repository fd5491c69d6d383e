"""What an evaluation's numbers say when taken together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from nufleet.orchestrator.evaluation.values import FlightError, StudyEstimate, TransferPair
from nufleet.orchestrator.flight_labels import BASELINE
from nufleet.shared.errors import InvalidInputError

SECOND = 2
"""The iteration that the paper's Fig. 4 compares the last one with."""


def second_and_last(
    estimates: Sequence[StudyEstimate],
) -> tuple[dict[str, list[float]], dict[str, list[float]]]:
    """Return each source's ψ̂*_n at the second and at every study's own last iteration.

    Raises:
        InvalidInputError: no study has a second iteration.
    """
    ends: dict[int, int] = {}
    for estimate in estimates:
        ends[estimate.study] = max(ends.get(estimate.study, 0), estimate.iteration)
    second: dict[str, list[float]] = {}
    last: dict[str, list[float]] = {}
    for estimate in estimates:
        if estimate.iteration == SECOND:
            second.setdefault(estimate.source, []).append(estimate.psi)
        if estimate.iteration == ends[estimate.study]:
            last.setdefault(estimate.source, []).append(estimate.psi)
    if not second:
        raise InvalidInputError("no study has a second iteration to be compared with its last")
    return second, last


def reduction(errors: Sequence[FlightError], prior: str) -> float | None:
    """Return by which share a prior's error is below the baseline's, averaged over the paths.

    It is the "% Red." of the paper's Table I: a mean of ratios. None where no path was finished
    both ways, or one was not finished with the prior.
    """
    before = {(e.drawing, e.speed_m_s): e.rms_error_m for e in errors if e.prior == BASELINE}
    ratios = [
        e.rms_error_m / before[e.drawing, e.speed_m_s]
        for e in errors
        if e.prior == prior and 0 < before.get((e.drawing, e.speed_m_s), 0.0) < np.inf
    ]
    return 1 - float(np.mean(ratios)) if ratios and np.isfinite(ratios).all() else None


def kendall_tau(predicted: Sequence[float], measured: Sequence[float]) -> float | None:
    """Return Kendall's τ-b of two orders (Kendall 1945); None where one of them orders nothing."""
    from scipy.stats import kendalltau

    if len(set(predicted)) < 2 or len(set(measured)) < 2:
        return None
    return float(kendalltau(predicted, measured).statistic)


def pooled_kendall_tau(pairs: Sequence[TransferPair]) -> float | None:
    """Return Kendall's τ-b of ψ̂* and the error ratio over all pairs together."""
    return kendall_tau([pair.psi for pair in pairs], [pair.ratio for pair in pairs])


def mean_kendall_tau(pairs: Sequence[TransferPair]) -> float | None:
    """Return Kendall's τ-b averaged over the targets, each by itself.

    It is sources for the same target that a selection compares.
    """
    targets = sorted({pair.target for pair in pairs})
    taus = [pooled_kendall_tau([pair for pair in pairs if pair.target == t]) for t in targets]
    known = [tau for tau in taus if tau is not None]
    return float(np.mean(known)) if known else None
