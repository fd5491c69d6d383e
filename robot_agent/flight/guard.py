"""Decides whether a transferred model still does better than the baseline, and when to withdraw it.

Pure decisions: given a tracking error, the guard returns the share of the learned correction that
may act.
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Positive, Strict
from nufleet.shared.wire.motions import TakenBack


class GuardSettings(Strict):
    """Limits on how much worse than its baseline a robot may fly before the prior is withdrawn.

    An error 10 % above the baseline's (21 % in the square) is tolerated. The budgets below use up a
    part of that; the rest is left for the lag of the loop.
    """

    budget: Positive = 0.02
    """Largest excess of the summed squared error over the baseline's, as a share of the baseline's
    sum over the whole path."""

    peak_ratio: Positive = 1.3
    """Largest error averaged over `window_s`, root mean square, as a multiple of the baseline's
    worst; exceeding it withdraws the prior at once."""

    window_s: Positive = 0.2
    """Length of the window, in seconds, over which `peak_ratio` averages the squared error."""

    restless_window_s: Positive = 0.3
    """Length of the window, in seconds, over which `restless_ratio` averages the squared
    acceleration of the correction."""

    restless_ratio: Positive = 2.3
    """Largest acceleration of the correction, as a multiple of the acceleration of the correction
    that would cancel the baseline's error.

    A correction that accelerates harder than this, and harder than a path may, withdraws the prior
    at once: it is an oscillation, which overturns a robot long before it is far off its path."""

    return_budget: Positive = 0.05
    """Largest excess of the summed squared error together with the cost of removing the present
    correction, should it be mistaken; a share of the baseline's sum over the whole path."""

    hand_over_s: Positive = 0.4
    """Time in seconds over which the correction fades out once the prior is withdrawn."""


class Guard:
    """Compares each tracking error with the one the baseline would have made at that sample."""

    def __init__(
        self,
        baseline_error: FloatArray,
        noise_variance: float,
        sample_time_s: float,
        acceleration_max: float,
        needed: FloatArray,
        settings: GuardSettings | None = None,
        *,
        correction_speed_max: float,
    ) -> None:
        """Prepare for one trajectory.

        Args:
            baseline_error: Tracking error predicted for the baseline on the whole path, without
                noise, shape (samples, axes), in the axes' units.
            noise_variance: Variance of the measured error, summed over the axes, in unit².
            sample_time_s: Sample time in seconds.
            acceleration_max: Largest acceleration of a path, in unit/s².
            needed: Correction of the reference that would cancel the baseline's error, shape
                (samples, axes), in the axes' units.
            settings: Limits of the guard; the defaults when None.
            correction_speed_max: Largest speed at which a correction may change, in unit/s.
        """
        chosen = settings or GuardSettings()
        square = (baseline_error**2).sum(axis=1)
        window = max(1, round(chosen.window_s / sample_time_s))
        smooth = np.convolve(square, np.ones(window) / window, mode="same")
        # Σ_{j ≤ k} (|b_j|² + σ²): the sum of squares that the baseline's error b_j, measured with
        # noise of variance σ², is expected to reach at sample k.
        self._allowed = np.cumsum(square + noise_variance)
        self._budget = chosen.budget * float(self._allowed[-1])
        # A mean over the few samples of a window may exceed the noise variance several times.
        self._peak = chosen.peak_ratio**2 * float(smooth.max()) + 4 * noise_variance
        self._recent = np.zeros(window)
        restless = max(3, round(chosen.restless_window_s / sample_time_s))
        self._accelerations = np.zeros(restless)
        # |n_{k+1} − 2 n_k + n_{k−1}|² / T⁴, the squared acceleration of the needed correction n,
        # averaged over the same window as that of the correction flown.
        pulls = (np.diff(needed, 2, axis=0) ** 2).sum(axis=1) / sample_time_s**4
        smooth = np.convolve(pulls, np.ones(restless) / restless, mode="same")
        needed_max = math.sqrt(smooth.max()) if len(smooth) else 0.0
        self._acceleration_max = max(acceleration_max, chosen.restless_ratio * needed_max)
        self._sample_time_s = sample_time_s
        self._corrections = np.zeros((3, baseline_error.shape[1]))
        self._hand_over = max(1, round(chosen.hand_over_s / sample_time_s))
        self._needed = needed
        self._step_max = correction_speed_max * sample_time_s
        self._return_budget = chosen.return_budget * float(self._allowed[-1])
        self._spent = 0.0
        self.event: TakenBack | None = None

    def judge(self, sample: int, error: FloatArray, correction: FloatArray) -> float:
        """Return the share of the learned correction that may act at a sample.

        To be called once for every sample, in order.

        Args:
            sample: Index of the sample, from 0.
            error: Tracking error at that sample, shape (axes,), in the axes' units. An error that
                is not finite withdraws the prior.
            correction: Last reference sent minus the path at that sample, shape (axes,), in the
                axes' units.

        Returns:
            The share, from 0 to 1.
        """
        square = float(error @ error)
        if self.event is None:
            self._spent += square
            self._recent[sample % len(self._recent)] = square
            self._accelerations[sample % len(self._accelerations)] = self._pull(correction)
            self.event = self._verdict(sample, square, correction)
        if self.event is None:
            return 1.0
        # A raised cosine from 1 to 0 over the hand-over, so that the reference does not jump.
        progress = (sample - self.event.sample + 1) / self._hand_over
        return 0.5 + 0.5 * math.cos(math.pi * min(1.0, progress))

    def _pull(self, correction: FloatArray) -> float:
        """Return the squared acceleration of the correction, in unit²/s⁴.

        The acceleration, a second difference quotient, is clipped at twice its bound: a single kink
        such as a corner of the path causes is no oscillation.
        """
        self._corrections = np.concatenate([self._corrections[1:], correction[np.newaxis]])
        second = np.diff(self._corrections, 2, axis=0)[0] / self._sample_time_s**2
        return min(float(second @ second), (2 * self._acceleration_max) ** 2)

    def _return_cost(self, sample: int, correction: FloatArray) -> float:
        """Return how much squared error, beyond the baseline's, removing a correction would add.

        The correction c shrinks in a straight line to zero at its largest speed v, here in unit per
        sample. Where the baseline would need n, a correction s leaves the squared error |s − n|²
        instead of |n|². The difference |s|² − 2 s·n summed over the samples of the removal is about
        (|c|³/3 − |c| c·n)/v, which is nothing for a correction of up to three times the one needed.
        """
        size = float(np.linalg.norm(correction))
        along = float(correction @ self._needed[sample])
        return max(0.0, size**3 / 3 - size * along) / self._step_max

    def _verdict(self, sample: int, square: float, correction: FloatArray) -> TakenBack | None:
        if not math.isfinite(square):
            return TakenBack(sample=sample, reason="the tracking error is not finite")
        # A model that is far off shows within one window.
        if float(self._recent.mean()) > self._peak:
            return TakenBack(
                sample=sample,
                reason=f"an error of {math.sqrt(self._recent.mean()):.3g}, more than the "
                "largest error of the baseline",
            )
        # An oscillation shows in the acceleration of the correction, which grows with ω², before it
        # shows in the error.
        pull = math.sqrt(self._accelerations.mean())
        if pull > self._acceleration_max:
            return TakenBack(
                sample=sample,
                reason=f"its corrections oscillate: their acceleration is {pull:.3g}, and no path "
                f"requires more than {self._acceleration_max:.3g}",
            )
        # Σ|e_j|² − Σ(|b_j|² + σ²): a model that is slightly worse all the way uses up the budget.
        # What it gained over the baseline earlier on the path counts in its favour.
        excess = self._spent - float(self._allowed[sample])
        if excess > self._budget:
            ratio = math.sqrt(self._spent / float(self._allowed[sample]))
            return TakenBack(
                sample=sample, reason=f"until now {ratio:.2f} times the error of the baseline"
            )
        # The prior must be withdrawn while that is still affordable: a large mistaken correction
        # keeps causing an error until it has been removed at its limited speed.
        if excess + self._return_cost(sample, correction) > self._return_budget:
            size, needed = np.linalg.norm(correction), np.linalg.norm(self._needed[sample])
            return TakenBack(
                sample=sample,
                reason=f"a correction of {size:.3g}, where the baseline needs {needed:.3g}: it "
                "could not be withdrawn in time later",
            )
        return None
