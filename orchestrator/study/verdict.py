"""To share or not to share: whether a source's experience will help the target, before it is tried.

Put before the target as a prefilter, the source's inverse leaves the error e = (1 − z_T/z_S) y_d;
without it the target's own loop leaves (1 − z_T) y_d. Transfer helps where the first is smaller; it
is not symmetric, since |1 − z_T/z_S| = |z_S − z_T| / |z_S|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.shared.arrays import ComplexArray, FloatArray

OUTSIDE_MAX = 0.05
OUTSIDE_REPORTED = 0.001
"""Share of the motion outside the tested band: above the first nothing can be said of the whole."""

GAIN_MIN = 1e-9
"""A source that answers less than this cannot be inverted."""


class Verdict(StrEnum):
    """What to do with a source's experience."""

    TRANSFER = "transfer"
    DO_NOT_TRANSFER = "do not transfer"
    NEED_MORE_TESTS = "need more tests"


@dataclass(frozen=True)
class Interval:
    """The median of what is believed of a quantity, and the bounds it lies in with 1 − δ."""

    low: FloatArray
    median: FloatArray
    high: FloatArray

    @staticmethod
    def of(samples: FloatArray, delta: float) -> Interval:
        """Return the interval of samples along their first axis."""
        low, median, high = np.quantile(samples, [delta / 2, 0.5, 1 - delta / 2], axis=0)
        return Interval(low, median, high)

    @staticmethod
    def of_magnitude(samples: ComplexArray, delta: float) -> Interval:
        """Return the interval of the norm of samples along their last axis; the first are samples.

        A norm is never negative, so samples of it lie above 0 even where there is none. Where the
        ball that holds the vector with probability 1 − δ also holds 0, the lower bound is 0.
        """
        norm = np.linalg.norm(samples, axis=-1)
        interval = Interval.of(norm, delta)
        centre = samples.mean(axis=0)
        reach = np.quantile(np.linalg.norm(samples - centre, axis=-1), 1 - delta, axis=0)
        # There only the upper bound can be missed.
        touching = np.linalg.norm(centre, axis=-1) <= reach
        high = np.where(touching, np.quantile(norm, 1 - delta, axis=0), interval.high)
        return Interval(np.where(touching, 0.0, interval.low), interval.median, high)


@dataclass(frozen=True)
class TransferPrediction:
    """What transfer from `source` to `target` is expected to do, and the verdict.

    The gains |error / trajectory| with and without transfer have shape (frequencies,); the errors
    are root mean squares relative to that of the trajectory; `reduction` is 1 − with / without.
    """

    source: str
    target: str
    omega_rad_s: FloatArray
    gain_with: Interval
    gain_without: Interval
    error_with: Interval
    error_without: Interval
    reduction: Interval
    probability_helps: float
    verdict: Verdict
    reason: str


def error_with_transfer(z_source: ComplexArray, z_target: ComplexArray) -> ComplexArray:
    """Return 1 − z_T/z_S, what the source's inverse leaves of each frequency of a trajectory."""
    answering = np.abs(z_source) > GAIN_MIN
    return np.asarray((z_source - z_target) / np.where(answering, z_source, GAIN_MIN))


def predict_transfer(
    source: tuple[str, ComplexArray],
    target: tuple[str, ComplexArray],
    spectrum: Spectrum,
    tested_band_rad_s: tuple[float, float],
    *,
    delta: float = 0.05,
) -> TransferPrediction:
    """Judge a transfer in one direction; exchange source and target for the other.

    Args:
        source: its name, and joint samples of its response at the spectrum's frequencies, shape
            (samples, frequencies).
        target: the same of the robot that the experience would go to.
        spectrum: of the trajectory to be flown, or flat.
        tested_band_rad_s: where the responses were measured.
        delta: probability of a wrong verdict that is accepted.
    """
    (source_name, z_source), (target_name, z_target) = source, target
    left_with, left_without = error_with_transfer(z_source, z_target), 1 - z_target
    scale = np.sqrt(spectrum.shares)
    error_with = Interval.of_magnitude(left_with * scale, delta)
    error_without = Interval.of_magnitude(left_without * scale, delta)
    relative = np.linalg.norm(left_with * scale, axis=1) / np.maximum(
        np.linalg.norm(left_without * scale, axis=1), GAIN_MIN
    )
    helps = float(np.mean(relative < 1))
    reduction = Interval.of(1 - relative, delta)
    if error_with.low == 0:
        reduction = replace(reduction, high=np.ones(()))
    verdict, reason = _judge(helps, reduction, spectrum.outside(tested_band_rad_s), delta)
    return TransferPrediction(
        source=source_name,
        target=target_name,
        omega_rad_s=spectrum.omega_rad_s,
        gain_with=Interval.of_magnitude(left_with[..., None], delta),
        gain_without=Interval.of_magnitude(left_without[..., None], delta),
        error_with=error_with,
        error_without=error_without,
        reduction=reduction,
        probability_helps=helps,
        verdict=verdict,
        reason=reason,
    )


def best_first(predictions: list[TransferPrediction]) -> list[TransferPrediction]:
    """Return the predictions of several sources for one target, smallest error first."""
    return sorted(predictions, key=lambda p: float(p.error_with.median))


def _judge(
    helps: float, reduction: Interval, outside: tuple[float, float], delta: float
) -> tuple[Verdict, str]:
    below, above = outside
    parts = [
        f"{100 * share:.2g} % of the trajectory's motion is {where} the tested band"
        for share, where in ((below, "below"), (above, "above"))
        if share > OUTSIDE_REPORTED
    ]
    leaves = f"; {' and '.join(parts)}" if parts else ""
    low, median, high = (100 * float(x) for x in (reduction.low, reduction.median, reduction.high))
    if below + above > OUTSIDE_MAX:
        return Verdict.NEED_MORE_TESTS, f"too much of it has not been tested{leaves}"
    # An interval with both ends on one side of 0, so that the words never contradict the numbers.
    if helps >= 1 - delta and low > 0:
        text = f"the error is expected to fall by {median:.0f} % ({low:.0f} to {high:.0f} %)"
        return Verdict.TRANSFER, text + leaves
    if helps <= delta and high < 0:
        text = f"the error is expected to grow by {-median:.0f} % ({-high:.0f} to {-low:.0f} %)"
        return Verdict.DO_NOT_TRANSFER, text + leaves
    text = (
        f"it helps with probability {helps:.2f}: the change of the error is between "
        f"{-high:+.0f} % and {-low:+.0f} %"
    )
    return Verdict.NEED_MORE_TESTS, text + leaves
