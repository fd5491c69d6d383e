"""The verdict on one transfer, as the document that other programs read."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Annotated

import numpy as np
from pydantic import Field

from nufleet.orchestrator.study.verdict import Interval, TransferPrediction, Verdict
from nufleet.shared.strict import Name, NonNegative, Reason, Strict
from nufleet.shared.wire.motions import PredictedError

_NINETY = 1.645  # standard deviations to either side of a normal's mean that hold 90 % of it
_TINY = 1e-12

Probability = Annotated[float, Field(ge=0, le=1)]


class Bounds(Strict):
    """The median of a number, and the bounds that contain it with probability 0.95.

    Where flights were rehearsed, the probability is 0.9."""

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


class Errors(Strict):
    """Errors on one axis, relative to the root mean square of the motion on this axis."""

    error_with: Bounds
    """Error with transfer."""
    error_without: Bounds
    """Error without transfer."""


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
    axes: dict[Name, Errors] | None = None
    """Errors on each axis, by axis, where several were tested; the gains are then those of the axis
    with the largest gain with transfer."""

    def error_on(self, axis: str) -> float:
        """Return the median of the relative error with transfer on an axis of the motion."""
        return (self.error_with if self.axes is None else self.axes[axis].error_with).median


def rehearsed(
    verdict: TransferVerdict,
    transferred: PredictedError,
    baseline: PredictedError,
    size: float,
    path: str,
) -> TransferVerdict:
    """Return a verdict with what the target expects of the experience as it would be flown.

    Frequency responses predict the error of an exact prefilter. What flies may be fed with the
    state, and learns online; it leaves a fraction of that error.

    Args:
        verdict: Verdict from frequency responses, whose gains remain.
        transferred: Error that the target expects with the experience, in the path's unit.
        baseline: Error that it expects without.
        size: Root mean square of the path about its mean, in that unit.
        path: What would be flown, in words.
    """
    with_, without = np.log([_three(transferred), _three(baseline)])
    ratio = with_[1] - without[1]
    # Both bounds are equally likely to be missed, and independently: their distances add as those
    # of normal logarithms do.
    down = float(np.hypot(with_[1] - with_[0], without[2] - without[1]))
    up = float(np.hypot(with_[2] - with_[1], without[1] - without[0]))
    low, median, high = (float(1 - np.exp(x)) for x in (ratio + up, ratio, ratio - down))
    spread = max((down if ratio > 0 else up) / _NINETY, _TINY)
    helps = 0.5 * math.erfc(ratio / (spread * math.sqrt(2)))
    found = Verdict.NEED_MORE_TESTS
    if low > 0 or high < 0:
        found = Verdict.TRANSFER if low > 0 else Verdict.DO_NOT_TRANSFER
    change = f"fall by {100 * median:.0f} % ({100 * low:.0f} to {100 * high:.0f} %)"
    if median < 0:
        change = f"grow by {-100 * median:.0f} % ({-100 * high:.0f} to {-100 * low:.0f} %)"
    return verdict.model_copy(
        update={
            "verdict": found,
            "reason": f"the error on {path} is expected to {change}, as rehearsed",
            "probability_helps": helps,
            "error_with": _shares(transferred, size),
            "error_without": _shares(baseline, size),
            "reduction": Bounds(low=low, median=median, high=high),
        }
    )


def _three(error: PredictedError) -> list[float]:
    return [max(_TINY, value) for value in (error.low, error.rms, error.high)]


def _shares(error: PredictedError, size: float) -> Bounds:
    return Bounds(low=error.low / size, median=error.rms / size, high=error.high / size)


def verdict_document(
    found: TransferPrediction,
    curves: Mapping[str, TransferPrediction],
    by_axis: Mapping[str, TransferPrediction],
) -> TransferVerdict:
    """Return the document of a prediction.

    Args:
        found: Prediction for the motion; gives the verdict, the errors and the reduction.
        curves: Prediction over the band by axis; gives the frequencies and the gains.
        by_axis: Prediction for the motion on each of several axes, by axis.
    """
    curve = max(curves.values(), key=lambda one: float(np.max(one.gain_with.median)))
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
        axes={
            axis: Errors(
                error_with=_bounds(one.error_with), error_without=_bounds(one.error_without)
            )
            for axis, one in by_axis.items()
        }
        or None,
    )


def _bounds(interval: Interval) -> Bounds:
    low, median, high = (float(x) for x in (interval.low, interval.median, interval.high))
    return Bounds(low=low, median=median, high=high)


def _curve(interval: Interval) -> GainCurve:
    low, median, high = (tuple(x.tolist()) for x in (interval.low, interval.median, interval.high))
    return GainCurve(low=low, median=median, high=high)
