"""The frequencies at which the chordal distance of two models equals a level, and their winding."""

from __future__ import annotations

import numpy as np

from nufleet.shared.arrays import ComplexArray
from nufleet.shared.models.half_plane import Image


def level_crossings(first: Image, second: Image, level: float) -> ComplexArray:
    """Return points that include every jω at which the sine of some angle equals the level γ.

    sin θ = γ holds for an angle θ between graph(P₁) and graph(P₂) iff there are v₁ in graph(P₁) and
    v₂ orthogonal to graph(P₂) with v₂ − γv₁ orthogonal to graph(P₁) and v₁ − γv₂ in graph(P₂). With
    v₁ = (u₁, P₁u₁) and v₂ = (P₂*w₂, −w₂), the differences written likewise, and P* realised by
    (−A*, −C*, B*, D*), these are linear equations between the states of P₁, P₁*, P₂ and P₂*. They
    have a solution at s = jω iff jω is an eigenvalue of the matrix built here.

    Args:
        first: Model P₁ with n₁ states, mapped to the half-plane.
        second: Model P₂ with n₂ states, mapped by the same map.
        level: Level γ.

    Returns:
        Points of the half-plane variable s, shape (2(n₁ + n₂),).
    """
    a1, b1, c1, d1 = first.a, first.b, first.c, first.d
    a2, b2, c2, d2 = second.a, second.b, second.c, second.d
    n1, n2 = len(a1), len(a2)
    outputs, inputs = d1.shape
    d1h, d2h = d1.conj().T, d2.conj().T
    kind = np.result_type(a1, a2)
    x1, z1 = slice(0, n1), slice(n1, 2 * n1)
    x2, z2 = slice(2 * n1, 2 * n1 + n2), slice(2 * n1 + n2, 2 * (n1 + n2))
    u, w = slice(0, inputs), slice(inputs, inputs + outputs)

    # The equations without derivatives, to be solved for u₁ and w₂ as functions of all states.
    algebraic = np.empty((inputs + outputs,) * 2, kind)
    algebraic[u, u] = -level * (np.eye(inputs) + d1h @ d1)
    algebraic[u, w] = d2h - d1h
    algebraic[w, u] = d1 - d2
    algebraic[w, w] = level * (np.eye(outputs) + d2 @ d2h)
    driven = np.zeros((inputs + outputs, 2 * (n1 + n2)), kind)
    driven[u, x1] = level * (d1h @ c1)
    driven[u, z1] = b1.conj().T
    driven[u, z2] = -b2.conj().T
    driven[w, x1] = -c1
    driven[w, x2] = c2
    driven[w, z2] = -level * (d2 @ b2.conj().T)
    solved = np.linalg.solve(algebraic, driven)
    u1, w2 = solved[u], solved[w]
    w1 = w2 + level * (d1 @ u1)
    w1[:, x1] += level * c1
    u2 = u1 - level * (d2h @ w2)
    u2[:, z2] -= level * b2.conj().T

    # The state equations of P₁, P₁*, P₂ and P₂*, with their inputs u₁, w₁, u₂ and w₂ inserted.
    matrix = np.empty((2 * (n1 + n2),) * 2, kind)
    matrix[x1] = b1 @ u1
    matrix[z1] = -c1.conj().T @ w1
    matrix[x2] = b2 @ u2
    matrix[z2] = -c2.conj().T @ w2
    matrix[x1, x1] += a1
    matrix[z1, z1] -= a1.conj().T
    matrix[x2, x2] += a2
    matrix[z2, z2] -= a2.conj().T
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)


def mixed_zeros(first: Image, second: Image) -> ComplexArray:
    """Return the n₁ + n₂ zeros of det(I + P₂*P₁), after cancelling the poles of P₁ and P₂*.

    They are the zeros of det(G₂*G₁), where G are the graph symbols, for any coprime factors,
    because feedback does not move zeros. G₁ is stable and G₂* antistable with n₂ poles, so
    det(G₂*G₁) winds (number of zeros in the right half-plane) − n₂ times around 0, irrespective of
    the poles of P₁ and P₂. Requires I + D₂*D₁ to be regular.

    Args:
        first: Model P₁ with n₁ states, mapped to the half-plane.
        second: Model P₂ with n₂ states, mapped by the same map.

    Returns:
        Zeros in the half-plane variable s, shape (n₁ + n₂,).
    """
    a1, b1, c1, d1 = first.a, first.b, first.c, first.d
    a2h, b2h = second.a.conj().T, second.b.conj().T
    c2h, d2h = second.c.conj().T, second.d.conj().T
    n1 = len(a1)
    output = np.concatenate([d2h @ c1, b2h], axis=1)
    control = -np.linalg.solve(np.eye(d1.shape[1]) + d2h @ d1, output)
    measured = d1 @ control
    measured[:, :n1] += c1
    matrix = np.concatenate([b1 @ control, -c2h @ measured])
    matrix[:n1, :n1] += a1
    matrix[n1:, n1:] -= a2h
    return np.asarray(np.linalg.eigvals(matrix), dtype=np.complex128)
