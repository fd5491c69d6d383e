"""The angles between subspaces, in which every distance between models is expressed."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.models.transfer_models import StateSpace


def sines(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Return the sines of the angles between pairs of subspaces, largest first.

    Args:
        first: bases, shape (k, q, r), of full column rank; they need not be orthonormal.
        second: bases, shape (k, q, s).

    Returns:
        The singular values of what of the first lies outside the second, shape (k, min(q − s, r)).
    """
    if first.shape[1:] == second.shape[1:] == (2, 1):
        across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        return np.asarray(np.abs(across) / lengths)
    beyond = np.linalg.qr(second, mode="complete").Q[:, :, second.shape[2] :]
    basis = np.linalg.qr(first).Q
    values = np.linalg.svd(np.swapaxes(beyond.conj(), 1, 2) @ basis, compute_uv=False)
    return np.asarray(np.minimum(values, 1.0))


def model_distance(first: StateSpace, second: StateSpace, omega_rad_s: FloatArray) -> FloatArray:
    """Return ψ(ω), the sine of the largest angle between the graphs, shape (k,).

    It equals σ_max[(I + P₂P₂*)^(−1/2) (P₂ − P₁) (I + P₁*P₁)^(−1/2)], and is defined at a pole too.
    """
    return sines(first.graph(omega_rad_s), second.graph(omega_rad_s))[:, 0]
