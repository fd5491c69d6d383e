"""The value of a test: the expected decrease of the probability of a wrong selection."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import ndtr, ndtri

from nufleet.shared.arrays import ComplexArray, FloatArray

RIDGE = 1e-9


def expected_gain(
    psi_star: FloatArray, leader: int, z: ComplexArray, variance: FloatArray, epsilon: float
) -> float:
    """Return the expected decrease of Σ_n P(source n is closer than the leader by more than ε).

    Every lead d_n = ψ*_n − ψ*_leader is assumed to be normal and linearly related to the test's
    measurements; both the distribution and the relation are estimated from the samples. A test that
    explains a share R² of the variance of d_n changes its mean by a normal variable with standard
    deviation √R² σ_n, and leaves the standard deviation σ_n √(1 − R²).

    Args:
        psi_star: Joint samples of the losses, shape (sources, samples).
        leader: Index of the source that is selected now.
        z: Response of the tested robot at the test's tones, in the same draws, shape
            (samples, tones).
        variance: Predicted variance E|ẑ − z|² of the test, shape (tones,).
        epsilon: Difference ε of two losses that does not matter.

    Returns:
        The expected decrease, summed over all sources but the leader.
    """
    leads = _leads(psi_star, leader)
    if not len(leads):
        return 0.0
    mean, deviation = leads.mean(axis=1), leads.std(axis=1)
    share = _explained_share(leads, z, variance)
    # The selected source need not have the least mean. What selecting another one would gain right
    # away is no merit of a test.
    before = _after(mean, deviation, np.zeros_like(share), epsilon)
    return float(np.sum(before - _after(mean, deviation, share, epsilon)))


def expected_errors(psi_star: FloatArray, leader: int, epsilon: float) -> float:
    """Return Σ_n P(source n is closer than the leader by more than ε), with normal leads.

    Args:
        psi_star: Joint samples of the losses, shape (sources, samples).
        leader: Index of the source that is selected now.
        epsilon: Difference ε of two losses that does not matter.
    """
    leads = _leads(psi_star, leader)
    return float(np.sum(_wrong(leads.mean(axis=1), leads.std(axis=1), epsilon)))


def expected_narrowing(psi_star: FloatArray, z: ComplexArray, variance: FloatArray) -> float:
    """Return the expected decrease of the standard deviation of a source's distance ψ*.

    Args:
        psi_star: Samples of the distance, shape (samples,).
        z: Response of the tested robot at the test's tones, in the same draws, shape
            (samples, tones).
        variance: Predicted variance E|ẑ − z|² of the test, shape (tones,).
    """
    share = float(_explained_share(psi_star[None], z, variance)[0])
    return float(np.std(psi_star)) * (1.0 - math.sqrt(1.0 - share))


def _leads(psi_star: FloatArray, leader: int) -> FloatArray:
    return np.delete(psi_star - psi_star[leader], leader, axis=0)


def _explained_share(values: FloatArray, z: ComplexArray, variance: FloatArray) -> FloatArray:
    """Return the share R² of the variance of each quantity that a test explains.

    Args:
        values: Samples of the quantities, shape (quantities, samples).
        z: Response of the tested robot at the test's tones, shape (samples, tones).
        variance: Predicted variance E|ẑ − z|² of the test, shape (tones,).
    """
    samples = values.shape[1]
    measured = np.concatenate([z.real, z.imag], axis=1)
    measured = measured - measured.mean(axis=0)
    # The error ẑ − z is circular: its real and imaginary parts have half the variance each.
    noise = np.concatenate([variance, variance]) / 2
    scale = np.sqrt(np.mean(measured**2, axis=0) + noise)
    measured, noise = measured / scale, noise / scale**2
    # R²_n = c_n Σ⁻¹ c_nᵀ / σ_n², with the measurements' covariance Σ and their covariance c_n with
    # the quantity. Measurements are scaled to unit variance, which keeps Σ well conditioned.
    covariance = measured.T @ measured / samples + np.diag(noise + RIDGE)
    centred = values - values.mean(axis=1, keepdims=True)
    cross = centred @ measured / samples
    explained = np.einsum("nj,jn->n", cross, np.linalg.solve(covariance, cross.T))
    share = explained / np.maximum(np.mean(centred**2, axis=1), 1e-300)
    # Adjusted R²: even unrelated regressors explain about 1 / `samples` of the variance each, so
    # the share expected by chance is removed. A noisy tone counts as a part of a regressor.
    effective = float(np.sum(1 - noise / np.diag(covariance)))
    adjusted = (share - effective / samples) / (1 - effective / samples)
    return np.asarray(np.clip(adjusted, 0.0, 1.0))


def _wrong(mean: FloatArray, deviation: FloatArray, epsilon: float) -> FloatArray:
    return np.asarray(ndtr(-(mean + epsilon) / np.maximum(deviation, 1e-12)))


# Midpoints of 101 equally likely intervals of a standard normal variable. The error has a kink
# where the selection changes, which makes Gauss–Hermite quadrature inaccurate.
_NODES = ndtri((np.arange(101) + 0.5) / 101)


def _after(
    mean: FloatArray, deviation: FloatArray, share: FloatArray, epsilon: float
) -> FloatArray:
    """Return the expected probability of error when the better of the two is selected afterwards.

    Args:
        mean: Means of the leads d_n before the test, shape (leads,).
        deviation: Standard deviations σ_n of the leads, shape (leads,).
        share: Shares R² of the variances that the test explains, shape (leads,).
        epsilon: Difference ε of two losses that does not matter.

    Returns:
        The probability for each lead, shape (leads,).
    """
    moved = mean[:, None] + np.sqrt(share)[:, None] * deviation[:, None] * _NODES
    left = np.maximum(deviation * np.sqrt(1 - share), 1e-12)[:, None]
    # The leader stays selected where d_n ≥ 0 is expected, and is wrong if d_n < −ε; otherwise
    # source n is selected, and is wrong if d_n > ε.
    error = np.where(moved >= 0, ndtr(-(moved + epsilon) / left), ndtr((moved - epsilon) / left))
    return np.asarray(error.mean(axis=1))
