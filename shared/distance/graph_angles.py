"""The angles between subspaces, which express every distance between models."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.models.transfer_models import StateSpace


def sines(first: ComplexArray, second: ComplexArray) -> FloatArray:
    """Return the sines of the angles between pairs of subspaces, largest first.

    Args:
        first: Bases of k subspaces, shape (k, q, r), of full column rank but not necessarily
            orthonormal.
        second: Bases of the k other subspaces, shape (k, q, s).

    Returns:
        Singular values of the part of the first basis, orthonormalised, that is orthogonal to the
        second subspace, shape (k, min(q − s, r)).
    """
    if first.shape[1:] == second.shape[1:] == (2, 1):
        # Two lines in the plane: the sine is their cross product over the product of lengths.
        across = first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0]
        lengths = np.linalg.norm(first, axis=1) * np.linalg.norm(second, axis=1)
        return np.asarray(np.abs(across) / lengths)
    beyond = np.linalg.qr(second, mode="complete").Q[:, :, second.shape[2] :]
    basis = np.linalg.qr(first).Q
    values = np.linalg.svd(np.swapaxes(beyond.conj(), 1, 2) @ basis, compute_uv=False)
    return np.asarray(np.minimum(values, 1.0))


def model_distance(first: StateSpace, second: StateSpace, omega_rad_s: FloatArray) -> FloatArray:
    """Return ψ(ω), the sine of the largest angle between the graphs of two models.

    It equals σ_max[(I + P₂P₂*)^(−1/2) (P₂ − P₁) (I + P₁*P₁)^(−1/2)], which for one input and one
    output is the paper's eq. (4); unlike that expression it is defined at a pole too.

    Args:
        first: A model P₁.
        second: A model P₂ with the same inputs, outputs and sample time.
        omega_rad_s: Frequencies, shape (k,).

    Returns:
        Distances in [0, 1], shape (k,).
    """
    return sines(first.graph(omega_rad_s), second.graph(omega_rad_s))[:, 0]
