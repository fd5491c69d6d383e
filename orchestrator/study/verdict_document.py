"""The verdict on one transfer, as the document that other programs read."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from nufleet.orchestrator.study.verdict import Interval, TransferPrediction, Verdict
from nufleet.shared.strict import NonNegative, Reason, Strict

Probability = Annotated[float, Field(ge=0, le=1)]


class Bounds(Strict):
    """The median of a number, and the bounds that contain it with probability 0.95."""

    low: float
    """Lower bound."""
    median: float
    """Median."""
    high: float
    """Upper bound."""


class GainCurve(Strict):
    """The gain |error / trajectory|: its median, and bounds that contain it with probability 0.95.

    The fields have one entry per frequency.
    """

    low: tuple[NonNegative, ...]
    """Lower bound at each frequency."""
    median: tuple[NonNegative, ...]
    """Median at each frequency."""
    high: tuple[NonNegative, ...]
    """Upper bound at each frequency."""


class TransferVerdict(Strict):
    """The expected effect of a transfer from one source, and the verdict on it.

    Errors are root mean squares relative to the root mean square of the motion: the requested
    trajectory or, without one, a motion with equal power throughout the band.
    """

    verdict: Verdict
    """Recommendation."""
    reason: Reason
    """Reason for the recommendation, for people."""
    probability_helps: Probability
    """Probability that transfer reduces the error."""
    error_with: Bounds
    """Relative error with transfer."""
    error_without: Bounds
    """Relative error without transfer."""
    reduction: Bounds
    """Relative reduction of the error, 1 − with / without."""
    omega_rad_s: tuple[float, ...]
    """Frequencies of the gains in rad/s, over the band."""
    gain_with: GainCurve
    """Gain |1 − z_T/z_S| with transfer at each frequency."""
    gain_without: GainCurve
    """Gain |1 − z_T| without transfer at each frequency."""


def verdict_document(found: TransferPrediction, curve: TransferPrediction) -> TransferVerdict:
    """Return the document of a prediction.

    Args:
        found: Prediction for the motion; gives the verdict, the errors and the reduction.
        curve: Prediction over the band; gives the frequencies and the gains.
    """
    return TransferVerdict(
        verdict=found.verdict,
        reason=found.reason,
        probability_helps=found.probability_helps,
        error_with=_bounds(found.error_with),
        error_without=_bounds(found.error_without),
        reduction=_bounds(found.reduction),
        omega_rad_s=tuple(curve.omega_rad_s.tolist()),
        gain_with=_curve(curve.gain_with),
        gain_without=_curve(curve.gain_without),
    )


def _bounds(interval: Interval) -> Bounds:
    low, median, high = (float(x) for x in (interval.low, interval.median, interval.high))
    return Bounds(low=low, median=median, high=high)


def _curve(interval: Interval) -> GainCurve:
    low, median, high = (tuple(x.tolist()) for x in (interval.low, interval.median, interval.high))
    return GainCurve(low=low, median=median, high=high)
