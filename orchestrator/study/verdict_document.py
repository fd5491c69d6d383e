"""The verdict on one transfer as other programs read it."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from nufleet.orchestrator.study.verdict import Interval, TransferPrediction, Verdict
from nufleet.shared.strict import NonNegative, Reason, Strict

Probability = Annotated[float, Field(ge=0, le=1)]


class Bounds(Strict):
    """A number's median, and the bounds that hold it with probability 0.95."""

    low: float
    median: float
    high: float


class GainCurve(Strict):
    """The same of the gain |error / trajectory| at each frequency."""

    low: tuple[NonNegative, ...]
    median: tuple[NonNegative, ...]
    high: tuple[NonNegative, ...]


class TransferVerdict(Strict):
    """What transfer from one source is expected to do.

    Errors are root mean squares relative to that of the motion: of the trajectory asked for, or of
    one with all frequencies of the band alike. `reduction` is 1 − with / without. The gains
    |1 − z_T/z_S| with and |1 − z_T| without transfer are those at `omega_rad_s`, over the band.
    """

    verdict: Verdict
    reason: Reason
    probability_helps: Probability
    error_with: Bounds
    error_without: Bounds
    reduction: Bounds
    omega_rad_s: tuple[float, ...]
    gain_with: GainCurve
    gain_without: GainCurve


def verdict_document(found: TransferPrediction, curve: TransferPrediction) -> TransferVerdict:
    """Return the document of a prediction, with the gains of another over the band."""
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
