"""The target's online Gaussian process: learns in flight what the prior inverse model leaves.

Implements the target's inverse model of the paper (Section III, the GP posterior with the source
robot's inverse dynamics as its prior mean).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum

import numpy as np

from nufleet.robot_agent.flight.inverse_model import InverseModel
from nufleet.shared.arrays import FloatArray
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.gaussian_process.online import OnlineFit
from nufleet.shared.gaussian_process.problem import Bounds, FitStatus, Hyperparameters

WINDOW_POINTS = 50
"""Number of latest pairs that the process is fitted to (paper, Section VI-C)."""

START = Hyperparameters(signal_variance=0.1, lengthscale=0.5, noise_variance=0.002)
"""Hyperparameters from which the first fit starts (paper, Section VI-C)."""

BOUNDS = Bounds(signal_variance=(1e-4, 1.0), lengthscale=(0.5, 100.0), noise_variance=(2e-4, 1.0))
"""Bounds on the fitted hyperparameters.

The inputs lie along one piece of path, so the likelihood says little about the directions across
it. With much less noise or shorter lengthscales the process would invent steep feedback there, and
learn from the oscillation that it causes itself."""


class Outcome(IntEnum):
    """Outcome of one axis's process at one sample."""

    PRIOR = 0
    """There are no pairs yet; γ is the prior's alone."""
    FITTED = 1
    """The window was fitted."""
    FIT_FAILED = 2
    """No jitter made the window's covariance positive definite; γ is the prior's alone."""
    NOT_FINITE = 3
    """The inputs, or the prior's value at them, are not finite; γ = 0."""


@dataclass(frozen=True, eq=False)
class Correction:
    """The output of the inverse model at one sample: γ = `prior` + `mean` for every axis.

    γ is a speed, in unit/s; see `InverseLayout`.
    """

    prior: FloatArray
    """Value of the prior inverse model, shape (axes,), in unit/s."""

    mean: FloatArray
    """Posterior mean of the process over what the prior leaves, shape (axes,), in unit/s."""

    variance: FloatArray
    """Posterior variance of the process, shape (axes,), in unit²/s²."""

    outcomes: tuple[Outcome, ...]
    """Outcome of every axis's process."""

    weights: FloatArray = field(default_factory=lambda: np.empty(0))
    """Weight of every expert of a mixture and, last, of none, shape (experts + 1,); the sum is 1.
    Empty for a single prior."""

    @property
    def gamma(self) -> FloatArray:
        """Output γ of the inverse model, shape (axes,), in unit/s."""
        return np.asarray(self.prior + self.mean)


class OnlineGp:
    """One process per axis over the residuals γ − prior(ξ), refitted for every new pair.

    Its mean is the second term of f_T(ξ*) = f_S(ξ*) + kᵀ(ξ*) (K + σ_n² I)⁻¹ (γ − f_S), where f_S is
    the prior (paper, Section III).

    No measurement makes it raise. A pair that is not finite is dropped and counted in `dropped`;
    repeated points leave the covariance invertible because the noise variance is bounded from
    below; `Outcome` names the remaining cases.
    """

    def __init__(
        self,
        layout: InverseLayout | CombinedLayout,
        priors: tuple[InverseModel | None, ...],
        *,
        window: int = WINDOW_POINTS,
        start: Hyperparameters = START,
        bounds: Bounds = BOUNDS,
    ) -> None:
        """Prepare for one flight.

        Args:
            layout: Inputs and output of the inverse model.
            priors: Prior inverse model of each axis; None for a zero prior.
            window: Number of latest pairs to fit; 0 learns nothing.
            start: Hyperparameters from which the first fit starts.
            bounds: Bounds on the fitted hyperparameters.
        """
        self._layout, self._priors, self._window = layout, priors, window
        dimension = layout.gp_inputs(np.zeros((1, len(layout.input_names)))).shape[1]
        self._fits = [
            OnlineFit(capacity=window, dimension=dimension, outputs=1, start=start, bounds=bounds)
            for _ in priors
            if window
        ]
        self._inputs: list[FloatArray] = [np.empty((0, dimension)) for _ in priors]
        self._residuals: list[FloatArray] = [np.empty((0, 1)) for _ in priors]
        self._changed = [True for _ in priors]
        self._start_variance = float(start.signal_variance)
        self._eased = np.zeros(len(priors))
        self._ease = 1.0 / (1.0 + layout.gp_ease_samples)
        self.dropped = 0
        self.weights = np.empty(0)
        """Weights of a mixture, of which a single prior has none."""

    @property
    def hyperparameters(self) -> tuple[Hyperparameters, ...]:
        """Hyperparameters of the latest fit of each axis; empty for a window of 0."""
        return tuple(fit.hyperparameters for fit in self._fits)

    def learn(self, axis: int, inputs: FloatArray, gamma: float) -> None:
        """Add a pair to an axis's window, from which the oldest pair drops out when it is full.

        Args:
            axis: Index of the axis.
            inputs: Inputs ξ of the inverse model, shape (inputs,), in the layout's order.
            gamma: Output γ that belongs to them, in unit/s.
        """
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
        self._changed[axis] = True

    def window(self, axis: int) -> FloatArray:
        """Return the process's own inputs of an axis's pairs, oldest first, shape (pairs, d)."""
        return self._inputs[axis]

    def relearn(self, axis: int, residuals: FloatArray) -> None:
        """Replace what the prior leaves of an axis's pairs, for a prior that has changed.

        Args:
            axis: Index of the axis.
            residuals: γ less the prior of each pair in the window, oldest first, shape (pairs,).
        """
        self._residuals[axis] = residuals[:, np.newaxis]
        self._changed[axis] = True

    def correct(self, inputs: FloatArray) -> Correction:
        """Fit every axis to its pairs and return γ at the inputs.

        A new mean takes effect gradually, over the layout's `gp_ease_samples`, so this is to be
        called exactly once per sample.

        Args:
            inputs: Inputs ξ of every axis, shape (axes, inputs), in the layout's order.
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
        # First-order low-pass, m(k) = m(k − 1) + (mean − m(k − 1)) / (1 + n) with n the layout's
        # `gp_ease_samples`: a mean that jumped from refit to refit would excite the robot.
        self._eased += self._ease * (mean - self._eased)
        return Correction(prior, self._eased.copy(), variance, tuple(outcomes))

    def _fit(self, axis: int) -> Outcome:
        if not len(self._inputs[axis]):
            return Outcome.PRIOR
        fit = self._fits[axis]
        # Pairs come every few samples, and a search that has converged would end where it begins.
        if self._changed[axis] or fit.status[0] != FitStatus.CONVERGED:
            fit.refit(self._inputs[axis], self._residuals[axis])
            self._changed[axis] = False
        if fit.status[0] == FitStatus.FAILED:
            fit.restart()
            return Outcome.FIT_FAILED
        return Outcome.FITTED

    def _prior(self, axis: int, row: FloatArray) -> float:
        prior = self._priors[axis]
        return 0.0 if prior is None else float(prior(row)[0])
