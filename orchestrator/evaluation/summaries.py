"""Summary statistics of an evaluation: scatter of the estimates, error reduction, Kendall's τ."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from nufleet.orchestrator.evaluation.values import FlightError, TransferPair
from nufleet.orchestrator.flights.labels import BASELINE
from nufleet.shared.arrays import FloatArray


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
    # SciPy has it too, and takes a second to load.
    before, after = (_signs(np.asarray(values)) for values in (predicted, measured))
    ordered = float(np.sqrt(np.abs(before).sum() * np.abs(after).sum()))
    return float(before @ after) / ordered if ordered else None


def _signs(values: FloatArray) -> FloatArray:
    """Return 1, 0 or −1 for each pair of values, as the first is greater, equal or less."""
    first, second = np.triu_indices(len(values), 1)
    greater, less = values[first] > values[second], values[first] < values[second]
    return greater.astype(np.float64) - less


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
