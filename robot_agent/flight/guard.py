"""Decides whether a learned correction does better than the baseline, and when to withdraw it.

Pure decisions: given a tracking error, the guard returns the share of the learned correction that
may act.
"""

from __future__ import annotations

import math
from typing import Literal

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.shared.strict import Positive, Strict
from nufleet.shared.text import in_thousandths, readable_unit
from nufleet.shared.wire.motions import TakenBack


class GuardSettings(Strict):
    """Limits on how much worse than its baseline a robot may fly before a correction is withdrawn.

    An error 10 % above the baseline's (21 % in the square) is tolerated. The budgets below use up a
    part of that; the rest is left for the lag of the loop.
    """

    budget: Positive = 0.02
    """Largest excess of the summed squared error over the baseline's, as a share of the baseline's
    sum over the whole path."""

    peak_ratio: Positive = 1.3
    """Largest error averaged over `window_s`, root mean square, as a multiple of the baseline's
    worst; exceeding it withdraws the correction at once."""

    window_s: Positive = 0.2
    """Length of the window, in seconds, over which `peak_ratio` averages the squared error."""

    restless_window_s: Positive = 0.3
    """Length of the window, in seconds, over which `restless_ratio` averages the squared
    acceleration of the correction."""

    restless_ratio: Positive = 2.3
    """Largest acceleration of the correction, as a multiple of the acceleration of the correction
    that would cancel the baseline's error.

    A correction that accelerates harder than this, and harder than a path may, is withdrawn at
    once: it is an oscillation, which overturns a robot long before it is far off its path."""

    earning_window_s: Positive = 1.0
    """Length of the window, in seconds, over which a correction shows that it earns its keep."""

    earning_ratio: Positive = 0.5
    """Error, as a multiple of what the baseline's would be over the same window, below which a
    correction does, so that withdrawing it would cost more than it could save."""

    earning_restless_ratio: Positive = 2.0
    """Multiple of the largest acceleration that is allowed to such a correction."""

    return_budget: Positive = 0.05
    """Largest excess of the summed squared error together with the cost of removing the present
    correction, should it be mistaken; a share of the baseline's sum over the whole path."""

    hand_over_s: Positive = 0.4
    """Time in seconds over which a correction fades out once it is withdrawn."""

    low: Positive = 0.05
    """Quantile of what the baseline may do that counts as its error: the less is known of it, the
    stricter the guard."""


class Guard:
    """Compares each tracking error with the one the baseline would have made at that sample.

    A correction that is withdrawn gives way to the best that is known besides: the robot's model of
    itself where there is one, which is then judged in the same way, and otherwise the baseline.
    """

    def __init__(
        self,
        baseline_squares: FloatArray,
        noise_variance: float,
        sample_time_s: float,
        acceleration_max: float,
        needed: FloatArray,
        settings: GuardSettings | None = None,
        *,
        correction_speed_max: float,
        fallback: bool = False,
        unit: str = "m",
    ) -> None:
        """Prepare for one trajectory.

        Args:
            baseline_squares: Squared distance to the path that the baseline may leave, without
                noise, in unit², shape (draws, samples): one row for each draw from the belief about
                the baseline, and a single one when that is known exactly.
            noise_variance: Variance of the measured error, summed over the axes, in unit².
            sample_time_s: Sample time in seconds.
            acceleration_max: Largest acceleration of a path, in unit/s².
            needed: Correction of the reference that would cancel the baseline's error, shape
                (samples, axes), in the axes' units.
            settings: Limits of the guard; the defaults when None.
            correction_speed_max: Largest speed at which a correction may change, in unit/s.
            fallback: Whether a withdrawn correction gives way to the robot's model of itself.
            unit: Unit of the axes, "m" or "rad", for the reasons.
        """
        chosen = settings or GuardSettings()
        self._settings, self._unit, self._sample_time_s = chosen, unit, sample_time_s
        samples = baseline_squares.shape[1]
        noisy = noise_variance * np.arange(1, samples + 1)
        # Σ_{j ≤ k} (|b_j|² + σ²): the sum of squares that the baseline's error b_j, measured with
        # noise of variance σ², is expected to reach at sample k.
        sums = np.cumsum(baseline_squares, axis=1) + noisy
        self._allowed = np.quantile(sums, chosen.low, axis=0)
        whole = float(self._allowed[-1])
        self._budget, self._return_budget = chosen.budget * whole, chosen.return_budget * whole

        def samples_in(duration_s: float, least: int) -> int:
            return max(least, round(duration_s / sample_time_s))

        window = samples_in(chosen.window_s, 1)
        worst = np.array([_smooth(row, window).max() for row in baseline_squares])
        # A mean over the few samples of a window may exceed the noise variance several times.
        worst_square = float(np.quantile(worst, chosen.low))
        self._peak = chosen.peak_ratio**2 * worst_square + 4 * noise_variance
        self._earning = samples_in(chosen.earning_window_s, 1)
        usual = np.quantile(baseline_squares, chosen.low, axis=0) + noise_variance
        self._usual = np.cumsum(usual)
        self._spent_at = np.zeros(samples + 1)
        self._recent = np.zeros(window)
        restless = samples_in(chosen.restless_window_s, 3)
        self._accelerations = np.zeros(restless)
        # |n_{k+1} − 2 n_k + n_{k−1}|² / T⁴, the squared acceleration of the needed correction n,
        # averaged over the same window as that of the correction flown.
        pulls = (np.diff(needed, 2, axis=0) ** 2).sum(axis=1) / sample_time_s**4
        needed_max = math.sqrt(_smooth(pulls, restless).max()) if len(pulls) else 0.0
        self._acceleration_max = max(acceleration_max, chosen.restless_ratio * needed_max)
        self._corrections = np.zeros((3, needed.shape[1]))
        self._hand_over = samples_in(chosen.hand_over_s, 1)
        self._needed = needed
        self._step_max = correction_speed_max * sample_time_s
        self._spent = 0.0
        self._fallback = fallback
        self._given_up: int | None = None
        self.event: TakenBack | None = None

    def judge(self, sample: int, error: FloatArray, correction: FloatArray) -> float:
        """Return the share of the learned correction that may act at a sample.

        To be called once for every sample, in order.

        Args:
            sample: Index of the sample, from 0.
            error: Tracking error at that sample, shape (axes,), in the axes' units. An error that
                is not finite withdraws the correction.
            correction: Last reference sent minus the path at that sample, shape (axes,), in the
                axes' units.

        Returns:
            The share, from 0 to 1.
        """
        square = float(error @ error)
        watching = self.event is None or (self._fallback and self._given_up is None)
        if watching:
            self._spent += square
            self._spent_at[sample + 1] = self._spent
            self._recent[sample % len(self._recent)] = square
            self._accelerations[sample % len(self._accelerations)] = self._pull(correction)
        if self.event is None:
            reason = self._verdict(sample, square, correction)
            if reason is not None:
                given_to: Literal["own", "baseline"] = "own" if self._fallback else "baseline"
                self.event = TakenBack(sample=sample, reason=reason, given_to=given_to)
        elif watching:
            reason = self._second_verdict(sample, square, self.event)
            if reason is not None:
                self._given_up = sample
                self.event = TakenBack(
                    sample=self.event.sample,
                    reason=f"{self.event.reason}; then its model of itself was taken back, too: "
                    f"{reason}",
                )
        return 1.0 if self.event is None else self._faded(sample, self.event.sample)

    def fallback_share(self, sample: int) -> float:
        """Return the share of the robot's own correction that acts at a sample already judged."""
        if not self._fallback or self.event is None:
            return 0.0
        kept = 1.0 if self._given_up is None else self._faded(sample, self._given_up)
        return kept * (1.0 - self._faded(sample, self.event.sample))

    def _faded(self, sample: int, since: int) -> float:
        """Return a raised cosine from 1 to 0 over the hand-over, so that no reference jumps."""
        progress = (sample - since + 1) / self._hand_over
        return 0.5 + 0.5 * math.cos(math.pi * min(1.0, progress))

    def _pull(self, correction: FloatArray) -> float:
        """Return the squared acceleration of the correction, in unit²/s⁴."""
        self._corrections = np.concatenate([self._corrections[1:], correction[np.newaxis]])
        second = np.diff(self._corrections, 2, axis=0)[0] / self._sample_time_s**2
        return float(second @ second)

    def _earns(self, sample: int) -> bool:
        """Return whether the robot has been much closer to its path than its baseline would be."""
        first = sample + 1 - self._earning
        if first < 0:
            return False
        flown = self._spent_at[sample + 1] - self._spent_at[first]
        usual = self._usual[sample] - (self._usual[first - 1] if first else 0.0)
        return bool(flown < self._settings.earning_ratio**2 * usual)

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

    def _verdict(self, sample: int, square: float, correction: FloatArray) -> str | None:
        """Return why the learned correction is withdrawn; None when it may stay."""
        reason = self._dangerous(sample, square) or self._restless(sample)
        if reason is not None:
            return reason
        excess = self._spent - float(self._allowed[sample])
        at = self._at(sample)
        if excess > self._budget:
            return f"{at} its error until then was {self._ratio(0, sample)}"
        if excess + self._return_cost(sample, correction) > self._return_budget:
            size, needed = (
                in_thousandths(float(np.linalg.norm(each)), self._unit)
                for each in (correction, self._needed[sample])
            )
            return (
                f"{at} its correction was {size}, where the baseline needs {needed}: later it "
                "could not be taken back in time"
            )
        return None

    def _second_verdict(self, sample: int, square: float, event: TakenBack) -> str | None:
        """Return why the robot's own correction is withdrawn; None when it may stay.

        It answers for what comes after the hand-over alone.
        """
        first = event.sample + self._hand_over + len(self._recent) + 1
        if sample < first:
            return None
        flown, allowed = self._sums(first, sample)
        reason = self._dangerous(sample, square)
        if reason is None and flown - allowed > self._budget:
            since_s = first * self._sample_time_s
            ratio = self._ratio(first, sample)
            reason = f"{self._at(sample)} the error since {since_s:.2f} s was {ratio}"
        return reason

    def _dangerous(self, sample: int, square: float) -> str | None:
        if not math.isfinite(square):
            return "the tracking error is not finite"
        recent, peak = math.sqrt(self._recent.mean()), math.sqrt(self._peak)
        if recent <= peak:
            return None
        factor, unit = readable_unit(recent, self._unit)
        error, worst = _told_apart(factor * recent, factor * peak)
        return (
            f"{self._at(sample)} the error was {error} {unit} RMS over {self._settings.window_s:g} "
            f"s, more than the baseline's worst allows, {worst} {unit}"
        )

    def _restless(self, sample: int) -> str | None:
        ratio = self._settings.earning_restless_ratio if self._earns(sample) else 1.0
        allowed = ratio * self._acceleration_max
        # Each acceleration is clipped at twice its bound: a single kink, such as a corner of the
        # path causes, is no oscillation.
        pull = math.sqrt(np.minimum(self._accelerations, (2 * allowed) ** 2).mean())
        if pull <= allowed:
            return None
        found, enough = _told_apart(pull, allowed)
        return (
            f"{self._at(sample)} its corrections oscillate: they accelerate by {found} "
            f"{self._unit}/s², which no path asks for; {enough} {self._unit}/s² is enough"
        )

    def _sums(self, first: int, last: int) -> tuple[float, float]:
        """Return the squared errors flown and allowed, summed from one sample to another."""
        before = float(self._allowed[first - 1]) if first else 0.0
        return self._spent - float(self._spent_at[first]), float(self._allowed[last]) - before

    def _ratio(self, first: int, last: int) -> str:
        sums = self._sums(first, last)
        flown, allowed = (math.sqrt(total / (last - first + 1)) for total in sums)
        ratio = flown / allowed if allowed > 0 else math.inf
        left, instead = (in_thousandths(each, self._unit) for each in (flown, allowed))
        return f"{ratio:.2f} times the error of the baseline: {left} RMS instead of {instead}"

    def _at(self, sample: int) -> str:
        return f"after {(sample + 1) * self._sample_time_s:.2f} s"


def _told_apart(larger: float, smaller: float) -> tuple[str, str]:
    """Return two numbers with three digits, or with as many as it takes to see which is larger."""
    texts = ((f"{larger:.{digits}g}", f"{smaller:.{digits}g}") for digits in range(3, 18))
    return next(pair for pair in texts if pair[0] != pair[1])


def _smooth(values: FloatArray, window: int) -> FloatArray:
    """Return the means of values over windows centred at each of them."""
    return np.convolve(values, np.ones(window) / window, mode="same")
