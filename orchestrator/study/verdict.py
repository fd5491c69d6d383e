"""Decides whether a source's experience will help the target, before the transfer is tried.

Placed before the target as a prefilter, the source's inverse leaves the error
e = (1 − z_T/z_S) y_d; without it the target's own loop leaves (1 − z_T) y_d. Transfer helps where
the first error is smaller. It is not symmetric, since |1 − z_T/z_S| = |z_S − z_T| / |z_S|.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import StrEnum

import numpy as np

from nufleet.orchestrator.study.trajectory_spectrum import Spectrum
from nufleet.shared.arrays import ComplexArray, FloatArray

OUTSIDE_MAX = 0.05
OUTSIDE_REPORTED = 0.001
"""Shares of the motion outside the tested band.

Above `OUTSIDE_MAX` no verdict on the whole motion is possible; above `OUTSIDE_REPORTED` the share
is mentioned in the reason.
"""

GAIN_MIN = 1e-9
"""Gain |z_S| below which a source's response cannot be inverted."""


class Verdict(StrEnum):
    """The recommendation about a source's experience."""

    TRANSFER = "transfer"
    DO_NOT_TRANSFER = "do not transfer"
    NEED_MORE_TESTS = "need more tests"


@dataclass(frozen=True)
class Interval:
    """The median of a quantity and the bounds that contain it with probability 1 − δ."""

    low: FloatArray
    """Lower bound; all three fields have the shape of the quantity."""
    median: FloatArray
    """Median."""
    high: FloatArray
    """Upper bound."""

    @staticmethod
    def of(samples: FloatArray, delta: float) -> Interval:
        """Return the interval of samples of shape (samples, ...), elementwise over the rest."""
        low, median, high = np.quantile(samples, [delta / 2, 0.5, 1 - delta / 2], axis=0)
        return Interval(low, median, high)

    @staticmethod
    def of_magnitude(samples: ComplexArray, delta: float) -> Interval:
        """Return the interval of the norm along the last axis.

        A norm is never negative, so its samples lie above 0 even where the true vector is 0. Where
        the ball that contains the vector with probability 1 − δ also contains 0, the lower bound is
        therefore set to 0. Elsewhere it is the quantile less twice the difference between the
        median and the norm of the mean: what is not known lengthens a vector in nearly every
        sample, and has lengthened the mean by as much.

        Args:
            samples: Samples of vectors, shape (samples, ..., components).
            delta: Probability δ that the interval misses the norm.
        """
        norm = np.linalg.norm(samples, axis=-1)
        interval = Interval.of(norm, delta)
        centre = samples.mean(axis=0)
        reach = np.quantile(np.linalg.norm(samples - centre, axis=-1), 1 - delta, axis=0)
        # Where 0 is the lower bound, only the upper one can be missed: it takes all of δ.
        touching = np.linalg.norm(centre, axis=-1) <= reach
        high = np.where(touching, np.quantile(norm, 1 - delta, axis=0), interval.high)
        above = np.maximum(interval.median - np.linalg.norm(centre, axis=-1), 0.0)
        low = np.where(touching, 0.0, np.maximum(interval.low - 2.0 * above, 0.0))
        return Interval(low, interval.median, high)


@dataclass(frozen=True)
class TransferPrediction:
    """The expected effect of a transfer from `source` to `target`, and the verdict on it."""

    source: str
    """Name of the robot that offers its experience."""
    target: str
    """Name of the robot that would receive it."""
    omega_rad_s: FloatArray
    """Frequencies of the gains in rad/s, shape (frequencies,)."""
    gain_with: Interval
    """Gain |1 − z_T/z_S| from trajectory to error with transfer, shape (frequencies,)."""
    gain_without: Interval
    """Gain |1 − z_T| from trajectory to error without transfer, shape (frequencies,)."""
    error_with: Interval
    """Root mean square error with transfer, relative to the trajectory's root mean square."""
    error_without: Interval
    """Root mean square error without transfer, relative to the trajectory's root mean square."""
    reduction: Interval
    """Relative reduction of the error, 1 − with / without."""
    probability_helps: float
    """Probability that transfer reduces the error."""
    verdict: Verdict
    """Recommendation."""
    reason: str
    """Reason for the recommendation, for people."""


def error_with_transfer(z_source: ComplexArray, z_target: ComplexArray) -> ComplexArray:
    """Return 1 − z_T/z_S, the gain from trajectory to error with the source's inverse.

    Args:
        z_source: Response of the source, shape (..., frequencies).
        z_target: Response of the target, in the same shape.

    Returns:
        The complex gain in the same shape; finite also where the source does not respond.
    """
    answering = np.abs(z_source) > GAIN_MIN
    return np.asarray((z_source - z_target) / np.where(answering, z_source, GAIN_MIN))


def predict_transfer(
    source: tuple[str, ComplexArray],
    target: tuple[str, ComplexArray],
    spectrum: Spectrum,
    tested_band_rad_s: tuple[float, float],
    *,
    across: tuple[ComplexArray, ComplexArray] | None = None,
    delta: float = 0.05,
) -> TransferPrediction:
    """Judge a transfer in one direction; exchange source and target to judge the other.

    Args:
        source: Name of the source, and joint samples of its response at the spectrum's frequencies,
            shape (samples, frequencies).
        target: Name of the robot that would receive the experience, and samples of its response in
            the same shape.
        spectrum: Spectrum of the trajectory to be flown, or a flat one.
        tested_band_rad_s: Lowest and highest frequency in rad/s at which responses were measured.
        across: Samples of the errors that other axes leave, with transfer and without, relative to
            the trajectory's root mean square, shape (samples, components); None of a single axis.
        delta: Accepted probability of a wrong verdict.
    """
    (source_name, z_source), (target_name, z_target) = source, target
    left_with, left_without = error_with_transfer(z_source, z_target), 1 - z_target
    # Parseval: the norm over frequencies, weighted with the roots of the power shares, is the root
    # mean square error relative to the trajectory's.
    scale = np.sqrt(spectrum.shares)
    all_with, all_without = left_with * scale, left_without * scale
    if across is not None:
        all_with = np.concatenate([all_with, across[0]], axis=1)
        all_without = np.concatenate([all_without, across[1]], axis=1)
    error_with = Interval.of_magnitude(all_with, delta)
    error_without = Interval.of_magnitude(all_without, delta)
    relative = np.linalg.norm(all_with, axis=1) / np.maximum(
        np.linalg.norm(all_without, axis=1), GAIN_MIN
    )
    helps = float(np.mean(relative < 1))
    reduction = Interval.of(1 - relative, delta)
    # Where no error at all is possible, a reduction of 100 % is, too.
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
        return Verdict.NEED_MORE_TESTS, f"too much of the motion is outside the tested band{leaves}"
    # Both ends of the interval must lie on one side of 0, so that the verdict never contradicts the
    # numbers in its reason.
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
