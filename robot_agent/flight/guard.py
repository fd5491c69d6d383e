"""Whether a transferred model still does better than the baseline would, and when to take it back.

Pure decisions: given an error, it answers with the share of the learned correction that may act.
"""

from __future__ import annotations

import math

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Positive, Strict
from nufleet.shared.wire.motions import TakenBack


class GuardSettings(Strict):
    """How much worse is allowed, and how fast the prior is taken back.

    The squared error may exceed the baseline's by `budget` of the baseline's whole, and together
    with what the way back from a mistaken correction would cost by `return_budget`; the rest of the
    tolerated 10 % (21 % of the square) is left for the lag of the loop. A squared error averaged
    over `window_s` that is `peak_ratio`² times the baseline's worst ends it at once. So does a
    correction that accelerates, over `restless_window_s`, harder than a path may and
    `restless_ratio` times as hard as the one that would take the baseline's error away: that is no
    correction but an oscillation, which throws a robot over long before it is far off its path.
    """

    budget: Positive = 0.02
    peak_ratio: Positive = 1.3
    window_s: Positive = 0.2
    restless_window_s: Positive = 0.3
    restless_ratio: Positive = 2.3
    return_budget: Positive = 0.05
    hand_over_s: Positive = 0.4


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
            baseline_error: predicted for the whole path, shape (samples, axes), without noise.
            noise_variance: of the measured error, summed over the axes.
            sample_time_s: between two samples.
            acceleration_max: of a path, in unit/s².
            needed: the correction that would take the baseline's error away, shape (samples, axes).
            settings: the defaults if left out.
            correction_speed_max: how fast a correction may change, in unit/s.
        """
        chosen = settings or GuardSettings()
        square = (baseline_error**2).sum(axis=1)
        window = max(1, round(chosen.window_s / sample_time_s))
        smooth = np.convolve(square, np.ones(window) / window, mode="same")
        self._allowed = np.cumsum(square + noise_variance)
        self._budget = chosen.budget * float(self._allowed[-1])
        # Over so few samples the noise may well be a few times its variance.
        self._peak = chosen.peak_ratio**2 * float(smooth.max()) + 4 * noise_variance
        self._recent = np.zeros(window)
        restless = max(3, round(chosen.restless_window_s / sample_time_s))
        self._accelerations = np.zeros(restless)
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
        """Take what happened until a sample and return the share of the correction, 0 to 1.

        Args:
            sample: the index, 0, 1, 2, ...
            error: at that sample, shape (axes,); one that is not finite counts as the worst.
            correction: how far the reference sent last was from the path, shape (axes,).
        """
        square = float(error @ error)
        if self.event is None:
            self._spent += square
            self._recent[sample % len(self._recent)] = square
            self._accelerations[sample % len(self._accelerations)] = self._pull(correction)
            self.event = self._verdict(sample, square, correction)
        if self.event is None:
            return 1.0
        progress = (sample - self.event.sample + 1) / self._hand_over
        return 0.5 + 0.5 * math.cos(math.pi * min(1.0, progress))

    def _pull(self, correction: FloatArray) -> float:
        """Return the squared acceleration of the correction.

        It is cut at twice the bound's: a single kink, as at a corner of a path, is no oscillation.
        """
        self._corrections = np.concatenate([self._corrections[1:], correction[np.newaxis]])
        second = np.diff(self._corrections, 2, axis=0)[0] / self._sample_time_s**2
        return min(float(second @ second), (2 * self._acceleration_max) ** 2)

    def _return_cost(self, sample: int, correction: FloatArray) -> float:
        """Return by how much the way back from a correction would exceed the baseline's square.

        On the way it shrinks at its largest speed v; where the baseline needs n, a correction s
        leaves |s − n|² instead of |n|². The sum of |s|² − 2 s·n over the way is
        (|c|³/3 − |c| c·n)/v: nothing for a correction of up to three times what is needed.
        """
        size = float(np.linalg.norm(correction))
        along = float(correction @ self._needed[sample])
        return max(0.0, size**3 / 3 - size * along) / self._step_max

    def _verdict(self, sample: int, square: float, correction: FloatArray) -> TakenBack | None:
        if not math.isfinite(square):
            return TakenBack(sample=sample, reason="the tracking error is not finite")
        if float(self._recent.mean()) > self._peak:
            return TakenBack(
                sample=sample,
                reason=f"an error of {math.sqrt(self._recent.mean()):.3g}, more than the "
                "baseline's worst",
            )
        pull = math.sqrt(self._accelerations.mean())
        if pull > self._acceleration_max:
            return TakenBack(
                sample=sample,
                reason=f"its corrections oscillate: they accelerate by {pull:.3g}, which no path "
                f"asks for; {self._acceleration_max:.3g} is enough",
            )
        excess = self._spent - float(self._allowed[sample])
        if excess > self._budget:
            ratio = math.sqrt(self._spent / float(self._allowed[sample]))
            return TakenBack(
                sample=sample, reason=f"so far {ratio:.2f} times the error of the baseline"
            )
        if excess + self._return_cost(sample, correction) > self._return_budget:
            size, needed = np.linalg.norm(correction), np.linalg.norm(self._needed[sample])
            return TakenBack(
                sample=sample,
                reason=f"a correction of {size:.3g}, where the baseline needs {needed:.3g}: later "
                "it could not be taken back in time",
            )
        return None
