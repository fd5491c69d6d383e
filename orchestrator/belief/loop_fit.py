"""Maximum a posteriori parameters of a loop and its modes, from many starts at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.loop_features import response_and_slope
from nufleet.shared.arrays import ComplexArray, FloatArray

ITERATIONS = 40
CONVERGED = 1e-6
"""Relative decrease of the cost; the search ends when no start achieves it any more."""


@dataclass(frozen=True)
class Tones:
    """The measured tones of a robot."""

    omega_rad_s: FloatArray
    """Frequencies in rad/s, shape (tones,)."""
    z: ComplexArray
    """Estimated response ẑ, shape (tones,)."""
    variance: FloatArray
    """Variance E|ẑ − z|² of each estimate, shape (tones,)."""

    def whiten(self, values: ComplexArray) -> FloatArray:
        """Return real and imaginary parts divided by their standard deviations.

        Args:
            values: Complex values at the tones, shape (..., tones).

        Returns:
            Real parts followed by imaginary parts, shape (..., 2 tones).
        """
        # Each part has half the variance of the circular complex error.
        scaled = values / np.sqrt(self.variance / 2)
        return np.concatenate([scaled.real, scaled.imag], axis=-1)


def fit_from(
    starts: FloatArray, tones: Tones, prior_mean: FloatArray, prior_std: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Minimise the negative log posterior from every start by the Levenberg–Marquardt method.

    Args:
        starts: Initial parameters, shape (starts, parameters).
        tones: Measurements to fit.
        prior_mean: Prior mean of the parameters, shape (parameters,) or (starts, parameters).
        prior_std: Prior standard deviation of the parameters, in either shape.

    Returns:
        The parameters found, shape (starts, parameters), and their costs, shape (starts,): half the
        sum of squared deviations from measurements and prior, in standard deviations.
    """
    theta = starts.copy()
    damping = np.full(len(starts), 1e-2)
    residual, slope = _deviations(theta, tones, prior_mean, prior_std)
    cost = 0.5 * np.sum(residual**2, axis=1)
    for _ in range(ITERATIONS):
        transposed = np.swapaxes(slope, 1, 2)
        normal = transposed @ slope
        gradient = (transposed @ residual[..., None])[..., 0]
        diagonal = np.einsum("sjj->sj", normal)
        # Marquardt's damping scales with the diagonal, so that steps do not depend on units:
        # (JᵀJ + λ diag JᵀJ) step = Jᵀr, with its own λ for every start.
        damped = normal + np.eye(theta.shape[1]) * (damping[:, None] * diagonal)[:, None, :]
        trial = theta - np.linalg.solve(damped, gradient[..., None])[..., 0]
        # No real robot lies farther from the prior, and the exp() of ln ω₀ and ln ζ would overflow.
        trial = np.clip(trial, prior_mean - 8 * prior_std, prior_mean + 8 * prior_std)
        trial_residual, trial_slope = _deviations(trial, tones, prior_mean, prior_std)
        trial_cost = 0.5 * np.sum(trial_residual**2, axis=1)
        better = trial_cost < cost
        worth = (cost - trial_cost)[better] > CONVERGED * cost[better]
        theta[better], cost[better] = trial[better], trial_cost[better]
        residual[better], slope[better] = trial_residual[better], trial_slope[better]
        damping = np.clip(np.where(better, damping / 5, damping * 5), 1e-9, 1e9)
        if better.any() and not worth.any():
            break
    return theta, cost


def _deviations(
    theta: FloatArray, tones: Tones, prior_mean: FloatArray, prior_std: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return the deviations from measurements and prior in standard deviations, and their slopes.

    The shapes are (starts, 2 tones + parameters) and (starts, 2 tones + parameters, parameters).
    """
    z, by_theta = response_and_slope(theta, tones.omega_rad_s)
    misfit = tones.whiten(z - tones.z)
    from_prior = (theta - prior_mean) / prior_std
    slope = np.swapaxes(tones.whiten(np.swapaxes(by_theta, -1, -2)), -1, -2)
    identity = np.broadcast_to(
        np.eye(theta.shape[1]) / prior_std[..., None], (len(theta), *[theta.shape[1]] * 2)
    )
    return (
        np.concatenate([misfit, from_prior], axis=1),
        np.concatenate([slope, identity], axis=1),
    )
