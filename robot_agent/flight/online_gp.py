"""The target's online Gaussian process: what the prior inverse model leaves, learned in flight."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from nufleet.robot_agent.flight.inverse_model import InverseModel
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.exact import Bounds, FitStatus, Hyperparameters
from nufleet.shared.gaussian_process.online import OnlineFit

WINDOW_POINTS = 50
"""The latest pairs that the process is fitted to (paper, Section VI-C)."""

START = Hyperparameters(signal_variance=0.1, lengthscale=0.5, noise_variance=0.002)
"""Where the search for the hyperparameters starts (paper, Section VI-C)."""

BOUNDS = Bounds(signal_variance=(1e-4, 1.0), lengthscale=(0.5, 100.0), noise_variance=(2e-4, 1.0))
"""Where it may end. The inputs lie along one piece of path, so the likelihood says little of what
is across it; with much less noise or shorter lengthscales the process invents steep feedback there
and teaches itself its own oscillation."""


class Outcome(IntEnum):
    """What became of the process of one axis at one sample."""

    PRIOR = 0
    """There are no pairs yet: the prior alone."""
    FITTED = 1
    """The window was fitted."""
    FIT_FAILED = 2
    """No jitter made the window's covariance positive definite: the prior alone."""
    NOT_FINITE = 3
    """The inputs, or what the prior makes of them, are not finite: γ = 0."""


@dataclass(frozen=True, eq=False)
class Correction:
    """γ of every axis, `prior` + `mean`, with the variance of `mean`; all of shape (axes,)."""

    prior: FloatArray
    mean: FloatArray
    variance: FloatArray
    outcomes: tuple[Outcome, ...]

    @property
    def gamma(self) -> FloatArray:
        """The inverse model's output, shape (axes,)."""
        return np.asarray(self.prior + self.mean)


class OnlineGp:
    """One process per axis over the residuals γ − prior(ξ), refitted for every answer.

    Nothing that a sensor measures makes it raise: a pair that is not finite is dropped and counted
    in `dropped`, repeated points are told apart by the noise variance, which is bounded from below,
    and for the rest see `Outcome`.
    """

    def __init__(
        self,
        layout: InverseLayout,
        priors: tuple[InverseModel | None, ...],
        *,
        window: int = WINDOW_POINTS,
        start: Hyperparameters = START,
        bounds: Bounds = BOUNDS,
    ) -> None:
        """Prepare for one prior per axis, None for a zero prior; a window of 0 learns nothing."""
        self._layout, self._priors, self._window = layout, priors, window
        dimension = layout.gp_inputs(np.zeros((1, len(layout.input_names)))).shape[1]
        self._fits = [
            OnlineFit(capacity=window, dimension=dimension, outputs=1, start=start, bounds=bounds)
            for _ in priors
            if window
        ]
        self._inputs: list[FloatArray] = [np.empty((0, dimension)) for _ in priors]
        self._residuals: list[FloatArray] = [np.empty((0, 1)) for _ in priors]
        self._start_variance = float(start.signal_variance)
        self._eased = np.zeros(len(priors))
        self._ease = 1.0 / (1.0 + layout.gp_ease_samples)
        self.dropped = 0

    @property
    def hyperparameters(self) -> tuple[Hyperparameters, ...]:
        """What each axis was last fitted with; none for a window of 0."""
        return tuple(fit.hyperparameters for fit in self._fits)

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        """Take the pair that has become available on an axis; `inputs` of shape (inputs,)."""
        if not self._window:
            return
        row = inputs[np.newaxis]
        residual = gamma - self._prior(axis, row) if np.isfinite(inputs).all() else np.nan
        if not np.isfinite(residual):
            self.dropped += 1
            return
        keep = 1 - self._window if self._window > 1 else len(self._inputs[axis])
        self._inputs[axis] = np.concatenate(
            [self._inputs[axis][keep:], self._layout.gp_inputs(row)]
        )
        self._residuals[axis] = np.concatenate([self._residuals[axis][keep:], [[residual]]])

    def correct(self, inputs: FloatArray) -> Correction:
        """Refit every axis and return γ at the inputs, shape (axes, inputs).

        The mean takes effect over the layout's `gp_ease_samples`, so call it once per sample.
        """
        axes = len(self._priors)
        prior, mean, variance = np.zeros(axes), np.zeros(axes), np.full(axes, self._start_variance)
        outcomes = []
        for axis in range(axes):
            row = inputs[axis : axis + 1]
            value = self._prior(axis, row) if np.isfinite(row).all() else np.nan
            if not np.isfinite(value):
                outcomes.append(Outcome.NOT_FINITE)
                continue
            prior[axis] = value
            outcomes.append(self._fit(axis))
            if outcomes[-1] is Outcome.FITTED:
                means, variances = self._fits[axis].predict(self._layout.gp_inputs(row))
                mean[axis], variance[axis] = means[0, 0], variances[0, 0]
        self._eased += self._ease * (mean - self._eased)
        return Correction(prior, self._eased.copy(), variance, tuple(outcomes))

    def _fit(self, axis: int) -> Outcome:
        if not len(self._inputs[axis]):
            return Outcome.PRIOR
        fit = self._fits[axis]
        fit.refit(self._inputs[axis], self._residuals[axis])
        if fit.status[0] == FitStatus.FAILED:
            fit.restart()
            return Outcome.FIT_FAILED
        return Outcome.FITTED

    def _prior(self, axis: int, row: FloatArray) -> float:
        prior = self._priors[axis]
        return 0.0 if prior is None else float(prior(row)[0])
