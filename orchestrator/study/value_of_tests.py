"""What a test is worth: how much less probable a wrong selection is expected to be after it."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr, ndtri

from nufleet.shared.arrays import ComplexArray, FloatArray

RIDGE = 1e-9


def expected_gain(
    psi_star: FloatArray, leader: int, z: ComplexArray, variance: FloatArray, epsilon: float
) -> float:
    """Return the expected decrease of Σ_n P(source n is closer than the leader by more than ε).

    Every lead d_n = ψ*_n − ψ*_leader is taken as normal, with a linear relation between it and what
    the test will measure, both estimated from the samples. A test that explains a share R² of d_n's
    variance moves its mean by √R² σ_n and leaves σ_n √(1 − R²).

    Args:
        psi_star: joint samples, shape (sources, samples).
        leader: index of the source selected now.
        z: the same samples of the tested robot's response at the test's tones, (samples, tones).
        variance: E|ẑ − z|² that the test will have, shape (tones,).
        epsilon: a difference that does not matter.
    """
    samples = psi_star.shape[1]
    leads = np.delete(psi_star - psi_star[leader], leader, axis=0)
    if not len(leads):
        return 0.0
    mean, deviation = leads.mean(axis=1), leads.std(axis=1)
    measured = np.concatenate([z.real, z.imag], axis=1)
    measured = measured - measured.mean(axis=0)
    noise = np.concatenate([variance, variance]) / 2
    scale = np.sqrt(np.mean(measured**2, axis=0) + noise)
    measured, noise = measured / scale, noise / scale**2
    covariance = measured.T @ measured / samples + np.diag(noise + RIDGE)
    centred = leads - mean[:, None]
    cross = centred @ measured / samples
    explained = np.einsum("nj,jn->n", cross, np.linalg.solve(covariance, cross.T))
    share = explained / np.maximum(deviation**2, 1e-300)
    # Regression on noise explains something too: about as many parts in `samples` as regressors.
    effective = float(np.sum(1 - noise / np.diag(covariance)))
    share = np.clip((share - effective / samples) / (1 - effective / samples), 0.0, 1.0)
    return float(np.sum(_wrong(mean, deviation, epsilon) - _after(mean, deviation, share, epsilon)))


def _wrong(mean: FloatArray, deviation: FloatArray, epsilon: float) -> FloatArray:
    return np.asarray(ndtr(-(mean + epsilon) / np.maximum(deviation, 1e-12)))


# Equally likely values of a normal variable: the error has a kink, which quadrature would miss.
_NODES = ndtri((np.arange(101) + 0.5) / 101)


def _after(
    mean: FloatArray, deviation: FloatArray, share: FloatArray, epsilon: float
) -> FloatArray:
    """Return the expected probability of error when the better of the two is selected then."""
    moved = mean[:, None] + np.sqrt(share)[:, None] * deviation[:, None] * _NODES
    left = np.maximum(deviation * np.sqrt(1 - share), 1e-12)[:, None]
    error = np.where(moved >= 0, ndtr(-(moved + epsilon) / left), ndtr((moved - epsilon) / left))
    return np.asarray(error.mean(axis=1))
